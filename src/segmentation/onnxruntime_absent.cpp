// Stands in for the ONNX Runtime backend in builds without it.
#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/segmenter_factory.hpp"

#include "segmentation/network.hpp"
#include "segmentation/onnxruntime_library.hpp"

namespace dynslam::segmentation {

std::unique_ptr<Network> make_onnxruntime_network(const OnnxFile& file, InputSize, int) {
  throw_io_error(file.path,
                 "cannot be run by the backend onnxruntime: dynslam was built without it "
                 "(cmake/install_dependencies.sh --onnxruntime, then build again)");
}

std::string onnxruntime_problem(const std::vector<std::string>&) {
  return "dynslam was built without it";
}

bool backend_available(Backend backend) { return backend == Backend::kOpenCv; }

}  // namespace dynslam::segmentation
