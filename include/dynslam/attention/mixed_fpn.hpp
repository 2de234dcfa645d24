// Feature pyramid with mixed attention (P-Mixed).
#pragma once

#include <cstddef>
#include <memory>

#include "dynslam/attention/cbam.hpp"
#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/attention/workspace.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::attention {

/// Feature pyramid over backbone maps F_0 (finest) ... F_{L-1} (coarsest; ResNet: F2..F5):
///
///     W_n = channel(spatial(lateral_n(F_n)))
///     M_n = W_n + nearest_upsample(M_{n+1}) to its size,   M_{L-1} = W_{L-1}
///     P_n = smooth_n(M_n)  (3x3, zero padding),            P_L = subsampled P_{L-1} (P6)
///
/// P6 is max_pool(P5) with a 1x1 window and stride 2, Mask R-CNN's: every second value. Upsampling
/// takes M[floor(y h / H)] as PyTorch does, so sizes may be odd.
///
/// Immutable and cheap to copy; one object may be used by many threads at once, each with its own
/// Workspace. NaN and determinism as in Cbam.
///
/// Source: P-Mixed (LOP 2023, 10.3788/LOP213265) with Lin et al., "Feature Pyramid Networks".
class MixedAttentionFpn {
 public:
  /// One entry a level, finest first; 1..16 levels. Throws InvalidArgument if weights do not fit
  /// together or levels differ in the pyramid's channels.
  explicit MixedAttentionFpn(Span<const FpnLevelWeights> levels,
                             CbamOrder order = CbamOrder::kSpatialFirst);

  int levels() const;
  int in_channels(int level) const;
  int channels() const;

  /// Floats that `run` needs for these backbone maps.
  std::size_t workspace_size(Span<const TensorBatch<const float>> inputs, int tasks = 1) const;

  /// `inputs[n]` is in_channels(n) x H_n x W_n, no coarser level larger than the finer one;
  /// `outputs[n]` channels() x H_n x W_n, and one more output of ceil(H/2) x ceil(W/2) of the
  /// coarsest for P6. No output may overlap an input or another output. Throws InvalidArgument for
  /// anything else, outputs untouched. Allocates only if an owned workspace has to grow.
  void run(Span<const TensorBatch<const float>> inputs, Span<const TensorBatch<float>> outputs,
           Workspace& workspace, Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace dynslam::attention
