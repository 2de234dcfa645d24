// Backends: the same network run by different libraries.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

#include "segmentation/onnx_file.hpp"

namespace dynslam::segmentation {

/// One output of a forward; the numbers live until the next forward.
struct NetworkOutput {
  std::string name;
  std::vector<std::int64_t> shape;
  const float* data = nullptr;
};

class Network {
 public:
  virtual ~Network() = default;

  /// Runs the network on `input` (1 x 3 x height x width, what was given at construction). Throws
  /// IoError naming the model if the backend fails.
  virtual const std::vector<NetworkOutput>& run(const float* input) = 0;
  virtual const char* backend() const = 0;
};

/// Input size in pixels of a network; what the file leaves open comes from the options.
struct InputSize {
  int width = 0;
  int height = 0;
};

/// The size of the one image input (1 x 3 x height x width). Throws IoError naming the file if the
/// inputs are others; InvalidArgument if the file leaves the size open and the options do too.
InputSize input_size_of(const OnnxFile& file, const NetworkOptions& options);

/// Throws IoError naming the model if the backend is not in this build or cannot load it.
std::unique_ptr<Network> make_network(const OnnxFile& file, const NetworkOptions& options,
                                      InputSize size);

/// As `make_network`, for the two backends.
std::unique_ptr<Network> make_opencv_network(const OnnxFile& file, InputSize size);
std::unique_ptr<Network> make_onnxruntime_network(const OnnxFile& file, InputSize size,
                                                  int threads);

/// The names of a network's classes: `wanted` if it has any, else the model's own, else COCO's if
/// there are 80, else "class 0", "class 1", ... Throws InvalidArgument if `wanted`, IoError naming
/// the model if its own list has another length than the network has classes.
std::vector<std::string> choose_class_names(const std::string& path, int classes,
                                            const std::vector<std::string>& wanted,
                                            const std::vector<std::string>& own);

/// The first line of an error of OpenCV, without the places in its sources.
std::string opencv_error_text(const std::string& what);

}  // namespace dynslam::segmentation
