// Memory that a layer works in.
#pragma once

#include <cstddef>
#include <memory>

#include "dynslam/core/span.hpp"

namespace dynslam::attention {

/// Scratch memory of the layers, either owned or given by the caller. One workspace serves any
/// number of layers one after another, but only one call at a time.
///
/// - Owned (`Workspace()`): grows when a layer asks for more than ever before and never shrinks.
///   After `reserve(layer.workspace_size(...))`, or after one call at the largest size, calls do
///   not allocate.
/// - Given (`Workspace(memory)`): never allocates; a layer that needs more throws InvalidArgument.
class Workspace {
 public:
  Workspace() = default;

  /// Works in `memory`, which has to outlive the workspace. Any alignment.
  explicit Workspace(Span<float> memory) : memory_(memory), given_(true) {}

  Workspace(Workspace&& other) noexcept;
  Workspace& operator=(Workspace&& other) noexcept;

  /// Number of floats there are.
  std::size_t size() const { return memory_.size(); }

  /// Provides at least `floats` floats. Throws InvalidArgument if the memory was given and is too
  /// small; contents are not kept.
  void reserve(std::size_t floats);

  /// The first `floats` floats, after `reserve(floats)`. Their values are unspecified.
  Span<float> take(std::size_t floats);

 private:
  std::unique_ptr<float[]> owned_;
  Span<float> memory_;
  bool given_ = false;
};

}  // namespace dynslam::attention
