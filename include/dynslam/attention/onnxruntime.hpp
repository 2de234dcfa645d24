// The layers inside ONNX Runtime's sessions.
#pragma once

struct OrtApiBase;
struct OrtSessionOptions;

namespace dynslam::attention {

/// Whether this build knows ONNX Runtime's interface.
bool has_onnxruntime_operators();

/// Adds the operators of the domain `dynslam` (see `fuse_onnx`) to the sessions made from
/// `options`: register_onnxruntime_operators(OrtGetApiBase(), options). Nothing is linked, so it
/// works with whichever ONNX Runtime from 1.16 on the caller has loaded. The operators run in the
/// thread that calls them. Throws InvalidArgument if a pointer is null, the runtime is too old or
/// this build does not know ONNX Runtime.
void register_onnxruntime_operators(const OrtApiBase* api, OrtSessionOptions* options);

}  // namespace dynslam::attention
