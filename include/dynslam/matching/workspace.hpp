// Scratch memory of the rules.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <memory>
#include <type_traits>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::matching {

/// Scratch of `reject` and of the rules: a stack of plain arrays that are handed out during a call
/// and taken back at its end.
///
/// Keep one for each thread and pass it to every call: from the second call on nothing is allocated
/// unless a call has more matches than any before it. Blocks never move, so that arrays handed out
/// stay valid while others are added. Not safe to share between two calls that run at once.
class Workspace {
 public:
  Workspace() = default;

  /// Arrays for calls with up to `matches` matches, allocated at once.
  explicit Workspace(std::size_t matches) { reserve(matches); }

  Workspace(Workspace&&) noexcept = default;
  Workspace& operator=(Workspace&&) noexcept = default;
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  /// Makes room for a call with `matches` matches under any rule of this room (a chain of many
  /// rules may need more and finds it by itself).
  void reserve(std::size_t matches) {
    const std::size_t wanted = kFixedBytes + kBytesPerMatch * matches;
    if (capacity() < wanted && used_blocks_ == 0) add_block(wanted);
  }

  /// Bytes held.
  std::size_t capacity() const {
    std::size_t bytes = 0;
    for (const Block& block : blocks_) bytes += block.size;
    return bytes;
  }

  /// Gives the arrays taken while it lived back at its end. `reject` holds one, rules may hold
  /// their own.
  class Frame {
   public:
    explicit Frame(Workspace& workspace)
        : workspace_(workspace), block_(workspace.used_blocks_), offset_(workspace.offset_) {}
    ~Frame() {
      workspace_.used_blocks_ = block_;
      workspace_.offset_ = offset_;
    }
    Frame(const Frame&) = delete;
    Frame& operator=(const Frame&) = delete;

   private:
    Workspace& workspace_;
    std::size_t block_;
    std::size_t offset_;
  };

  /// Uninitialized array of `count` elements, aligned to 64 bytes; valid until the enclosing Frame
  /// ends.
  template <typename T>
  Span<T> take(std::size_t count) {
    static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>,
                  "scratch is raw memory");
    static_assert(alignof(T) <= kAlignment);
    return {reinterpret_cast<T*>(take_bytes(count * sizeof(T))), count};
  }

  /// As `take`, every element set to `value`.
  template <typename T>
  Span<T> take_filled(std::size_t count, T value) {
    const Span<T> span = take<T>(count);
    std::fill(span.begin(), span.end(), value);
    return span;
  }

 private:
  static constexpr std::size_t kAlignment = 64;
  static constexpr std::size_t kFixedBytes = std::size_t{1} << 17;
  static constexpr std::size_t kBytesPerMatch = 256;

  struct Block {
    std::unique_ptr<unsigned char[]> bytes;
    std::size_t start = 0;  // of the first aligned byte
    std::size_t size = 0;   // from there
  };

  unsigned char* take_bytes(std::size_t bytes) {
    bytes = (bytes + kAlignment - 1) / kAlignment * kAlignment;
    while (used_blocks_ < blocks_.size() && offset_ + bytes > blocks_[used_blocks_].size) {
      ++used_blocks_;
      offset_ = 0;
    }
    if (used_blocks_ == blocks_.size()) add_block(std::max(bytes, kFixedBytes));
    Block& block = blocks_[used_blocks_];
    unsigned char* result = block.bytes.get() + block.start + offset_;
    offset_ += bytes;
    return result;
  }

  void add_block(std::size_t size) {
    Block block;
    block.bytes.reset(new unsigned char[size + kAlignment]);
    const auto address = reinterpret_cast<std::size_t>(block.bytes.get());
    block.start = (kAlignment - address % kAlignment) % kAlignment;
    block.size = size;
    // A larger block goes first, where the next call looks first.
    const bool idle = used_blocks_ == 0 && offset_ == 0;
    blocks_.insert(idle ? blocks_.begin() : blocks_.end(), std::move(block));
  }

  std::vector<Block> blocks_;
  std::size_t used_blocks_ = 0;  // index of the block in use
  std::size_t offset_ = 0;       // first free byte in it
};

}  // namespace dynslam::matching
