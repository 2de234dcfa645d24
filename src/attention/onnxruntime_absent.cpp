// A build without ONNX Runtime's header.
#include "dynslam/attention/onnxruntime.hpp"
#include "dynslam/core/errors.hpp"

namespace dynslam::attention {

bool has_onnxruntime_operators() { return false; }

void register_onnxruntime_operators(const OrtApiBase* /*api*/, OrtSessionOptions* /*options*/) {
  throw_invalid_argument("register_onnxruntime_operators", "dynslam",
                         "a build without ONNX Runtime",
                         "one configured with DYNSLAM_ONNXRUNTIME_DIR");
}

}  // namespace dynslam::attention
