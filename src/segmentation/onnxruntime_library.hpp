// Finding ONNX Runtime while the program runs.
#pragma once

#include <string>
#include <vector>

namespace dynslam::segmentation {

/// Why none of these shared libraries can serve as ONNX Runtime, the last reason first; empty if
/// one can. Loads it. In a build without ONNX Runtime none can.
std::string onnxruntime_problem(const std::vector<std::string>& libraries);

}  // namespace dynslam::segmentation
