#include "segmentation/network.hpp"

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

void NetworkOptions::validate() const {
  require(threads >= 0 && threads <= 1024, "NetworkOptions", "threads", threads, "0 to 1024");
  require(score_threshold >= 0.0F && score_threshold <= 1.0F, "NetworkOptions", "score_threshold",
          score_threshold, "a number from 0 to 1");
  require(nms_threshold >= 0.0F && nms_threshold <= 1.0F, "NetworkOptions", "nms_threshold",
          nms_threshold, "a number from 0 to 1");
  require(max_instances > 0, "NetworkOptions", "max_instances", max_instances, "at least 1");
  require((input_width == 0) == (input_height == 0), "NetworkOptions", "input_width, input_height",
          std::to_string(input_width) + ", " + std::to_string(input_height), "both or neither");
  require(input_width >= 0 && input_width <= 8192, "NetworkOptions", "input_width", input_width,
          "0 to 8192");
  require(input_height >= 0 && input_height <= 8192, "NetworkOptions", "input_height", input_height,
          "0 to 8192");
}

InputSize input_size_of(const OnnxFile& file, const NetworkOptions& options) {
  const auto& inputs = file.inputs;
  // torchvision's detectors take an image without a batch.
  const std::size_t rank = inputs.size() == 1 ? inputs[0].shape.size() : 0;
  const auto is_or_open = [&](std::size_t axis, std::int64_t value) {
    return inputs[0].shape[axis] == value || inputs[0].shape[axis] == -1;
  };
  const bool fits =
      (rank == 4 && is_or_open(0, 1) && is_or_open(1, 3)) || (rank == 3 && is_or_open(0, 3));
  if (!fits) {
    throw_io_error(file.path,
                   "takes " + tensors_text(inputs) + "; expected one image input 1x3xHEIGHTxWIDTH");
  }
  const std::int64_t height = inputs[0].shape[rank - 2];
  const std::int64_t width = inputs[0].shape[rank - 1];
  const bool open = height < 0 || width < 0;
  if (open) {
    require(options.input_width > 0, "NetworkOptions", "input_width, input_height",
            "no size, and " + file.path + " leaves its own open (" + tensors_text(inputs) + ")",
            "the size to run this network at");
    const bool agrees = (height < 0 || height == options.input_height) &&
                        (width < 0 || width == options.input_width);
    require(agrees, "NetworkOptions", "input_width, input_height",
            std::to_string(options.input_width) + ", " + std::to_string(options.input_height),
            "what " + file.path + " takes: " + tensors_text(inputs));
    return {options.input_width, options.input_height};
  }
  if (height > 8192 || width > 8192) {
    throw_io_error(file.path, "takes " + tensors_text(inputs) + "; expected at most 8192 pixels");
  }
  require(
      options.input_width == 0 || (options.input_width == width && options.input_height == height),
      "NetworkOptions", "input_width, input_height",
      std::to_string(options.input_width) + ", " + std::to_string(options.input_height),
      "none, or the fixed size of " + file.path + ": " + tensors_text(inputs));
  return {static_cast<int>(width), static_cast<int>(height)};
}

std::vector<std::string> choose_class_names(const std::string& path, int classes,
                                            const std::vector<std::string>& wanted,
                                            const std::vector<std::string>& own) {
  const auto count = static_cast<std::size_t>(classes);
  if (!wanted.empty()) {
    require(wanted.size() == count, "NetworkOptions", "class_names",
            std::to_string(wanted.size()) + " names",
            std::to_string(classes) + ", the classes of " + path);
    return wanted;
  }
  if (!own.empty()) {
    if (own.size() != count) {
      throw_io_error(path, "names " + std::to_string(own.size()) +
                               " classes, but its outputs have room for " +
                               std::to_string(classes));
    }
    return own;
  }
  if (count == coco_class_names().size()) return coco_class_names();
  std::vector<std::string> numbered;
  for (int i = 0; i < classes; ++i) numbered.push_back("class " + std::to_string(i));
  return numbered;
}

std::unique_ptr<Network> make_network(const OnnxFile& file, const NetworkOptions& options,
                                      InputSize size) {
  if (options.backend == Backend::kOnnxRuntime) {
    return make_onnxruntime_network(file, size, options.threads);
  }
  return make_opencv_network(file, size);
}

}  // namespace dynslam::segmentation
