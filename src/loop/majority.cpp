#include "loop/majority.hpp"

#include <algorithm>

namespace dynslam::loop::detail {

void BitCounter::clear() {
  std::fill(planes_.begin(), planes_.end(), 0);
  std::fill(counts_.begin(), counts_.end(), 0);
  waiting_ = 0;
  added_ = 0;
}

void BitCounter::flush() {
  if (waiting_ == 0) return;
  for (std::size_t w = 0; w < words_; ++w) {
    for (std::size_t p = 0; p < kPlanes; ++p) {
      std::uint64_t& plane = plane_of(p, w);
      if (plane == 0) continue;
      for (std::size_t b = 0; b < 64; ++b) {
        counts_[w * 64 + b] += static_cast<std::uint32_t>(plane >> b & 1U) << p;
      }
      plane = 0;
    }
  }
  waiting_ = 0;
}

void BitCounter::add(BitCounter& other) {
  other.flush();
  for (std::size_t i = 0; i < counts_.size(); ++i) counts_[i] += other.counts_[i];
  added_ += other.added_;
}

void BitCounter::majority(std::uint64_t* descriptor) {
  flush();
  for (std::size_t w = 0; w < words_; ++w) {
    std::uint64_t word = 0;
    for (std::size_t b = 0; b < 64; ++b) {
      if (added_ > 0 && std::size_t{2} * counts_[w * 64 + b] >= added_)
        word |= std::uint64_t{1} << b;
    }
    descriptor[w] = word;
  }
}

}  // namespace dynslam::loop::detail
