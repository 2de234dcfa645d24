// Hands out pieces of a workspace, or counts what they would take.
#pragma once

#include <cstddef>
#include <cstdint>

#include "dynslam/attention/workspace.hpp"

namespace dynslam::attention::detail {

class Arena {
 public:
  /// Counts: `take` gives null.
  Arena() = default;

  /// Hands out `workspace`, which is made to hold `floats` (what a counting arena said).
  Arena(Workspace& workspace, std::size_t floats) : base_(workspace.take(floats).data()) {
    const auto address = reinterpret_cast<std::uintptr_t>(base_);
    base_ += (kAlignment - address / sizeof(float) % kAlignment) % kAlignment;
  }

  /// A piece of `count` floats at the start of a cache line (if floats lie at multiples of four).
  float* take(std::size_t count) {
    const std::size_t at = used_;
    used_ += (count + kAlignment - 1) / kAlignment * kAlignment;
    return base_ == nullptr ? nullptr : base_ + at;
  }

  /// Floats that a workspace needs for what was taken.
  std::size_t total() const { return used_ + kAlignment; }

 private:
  static constexpr std::size_t kAlignment = 16;
  float* base_ = nullptr;
  std::size_t used_ = 0;
};

}  // namespace dynslam::attention::detail
