#include "dynslam/attention/workspace.hpp"

#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::attention {

Workspace::Workspace(Workspace&& other) noexcept
    : owned_(std::move(other.owned_)),
      memory_(std::exchange(other.memory_, {})),
      given_(std::exchange(other.given_, false)) {}

Workspace& Workspace::operator=(Workspace&& other) noexcept {
  if (this != &other) {
    owned_ = std::move(other.owned_);
    memory_ = std::exchange(other.memory_, {});
    given_ = std::exchange(other.given_, false);
  }
  return *this;
}

void Workspace::reserve(std::size_t floats) {
  if (floats <= memory_.size()) return;
  require(!given_, "Workspace::reserve", "memory given (floats)", memory_.size(), floats);
  // The old piece goes first: its contents are not kept, and both need not exist at once.
  memory_ = {};
  owned_.reset();
  owned_.reset(new float[floats]);
  memory_ = Span<float>(owned_.get(), floats);
}

Span<float> Workspace::take(std::size_t floats) {
  reserve(floats);
  return memory_.subspan(0, floats);
}

}  // namespace dynslam::attention
