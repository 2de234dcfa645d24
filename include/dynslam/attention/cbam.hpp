// Channel and spatial attention, in either order.
#pragma once

#include <cstddef>
#include <memory>

#include "dynslam/attention/executor.hpp"
#include "dynslam/attention/tensor_batch.hpp"
#include "dynslam/attention/weights.hpp"
#include "dynslam/attention/workspace.hpp"

namespace dynslam::attention {

enum class CbamOrder {
  kChannelFirst,  ///< CBAM's own
  kSpatialFirst,  ///< the mixed attention of P-Mixed
  kChannelOnly,
  kSpatialOnly,
  kNone,  ///< copies; the null version
};

/// Convolutional block attention:
///
///     channel(F) = F * sigmoid( W1 relu(W0 mean_hw F + b0) + W1 relu(W0 max_hw F + b0) + 2 b1 )
///     spatial(F) = F * sigmoid( conv_KxK([max_c F; mean_c F]) + b )
///
/// one applied to the result of the other. The map is read twice and written once (the second
/// reading of its spatial part comes from the cache, a band of rows at a time), where a chain of
/// operators walks it a dozen times.
///
/// Immutable and cheap to copy; one object may be used by many threads at once, each with its own
/// Workspace. Results depend on the vector instructions in the last bits, not on the executor. A
/// NaN anywhere makes its whole image NaN in the channel attention, and the K x K neighbourhood of
/// its pixel in the spatial one, through the mean; PyTorch does the same.
///
/// Source: Woo et al., "CBAM", ECCV 2018; P-Mixed equations 1-7 (LOP 2023).
class Cbam {
 public:
  /// Throws InvalidArgument if the weights do not fit together.
  explicit Cbam(const CbamWeights& weights, CbamOrder order = CbamOrder::kChannelFirst);

  int channels() const;
  CbamOrder order() const;

  /// Floats that `run` needs in its workspace.
  std::size_t workspace_size(int height, int width, int tasks = 1) const;

  /// Both views are channels() x H x W of the same batch size. `output` may be the same view as
  /// `input`; any other overlap throws InvalidArgument, as do empty and mismatched views. Outputs
  /// are then untouched. O(batch C H W); allocates only if an owned workspace has to grow.
  void run(TensorBatch<const float> input, TensorBatch<float> output, Workspace& workspace,
           Executor executor = {}) const;

 private:
  struct Impl;
  std::shared_ptr<const Impl> impl_;
};

}  // namespace dynslam::attention
