// Others that run the same layer, each in a file of its own that the build leaves out where the
// library is missing.
#pragma once

#include <memory>
#include <string>

#include "dynslam/attention/safetensors.hpp"

namespace dynslam::attention::bench {

/// A layer loaded with its weights and inputs.
class Rival {
 public:
  virtual ~Rival() = default;
  virtual void run() = 0;
  /// Values of the last run in NCHW; valid until the next.
  virtual const float* output() = 0;
};

/// From <stem>.pt, frozen (normalization folded) and then optimized for inference; one thread. Null
/// if this build has no libtorch.
std::unique_ptr<Rival> make_torch(const std::string& stem, const SafeTensors& data);

/// From <stem>.onnx, all graph optimizations; one thread. Null if this build has no ONNX Runtime.
/// `fused` runs our operators in it.
std::unique_ptr<Rival> make_onnxruntime(const std::string& stem, const SafeTensors& data,
                                        bool fused);

/// The DFC chain in the layouts that oneDNN chooses itself; threads as OMP_NUM_THREADS says. The
/// reorders of inputs and output are left out of `run` unless `with_reorders`. Null if this build
/// has no oneDNN.
std::unique_ptr<Rival> make_onednn_dfc(const SafeTensors& data, bool with_reorders);

}  // namespace dynslam::attention::bench
