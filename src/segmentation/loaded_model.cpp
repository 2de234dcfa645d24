#include "segmentation/loaded_model.hpp"

#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

const std::vector<NetworkOutput>& LoadedModel::load(const std::string& path,
                                                    const NetworkOptions& wanted) {
  wanted.validate();
  options = wanted;
  file = read_onnx_file(path);
  size = input_size_of(file, options);
  network = make_network(file, options, size);
  // The first forward sets up buffers, and shows the shapes that the file may leave open.
  blob.assign(static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height) * 3,
              0.5F);
  const auto& outputs = network->run(blob.data());
  info.source = file.path;
  info.sha256 = file.sha256;
  info.backend = network->backend();
  info.inputs = file.inputs;
  info.outputs = describe(outputs);
  file.bytes.clear();
  file.bytes.shrink_to_fit();
  return outputs;
}

const std::vector<NetworkOutput>& LoadedModel::run(const cv::Mat& image, const Letterbox& letterbox,
                                                   const PixelScale& pixels, Segmentation& result) {
  result.width = image.cols;
  result.height = image.rows;
  fill_input(image, letterbox, pixels, blob, planes);
  const Stopwatch forward;
  const auto& outputs = network->run(blob.data());
  result.network_ms = forward.ms();
  return outputs;
}

void LoadedModel::refuse_outputs(const std::vector<NetworkOutput>& outputs,
                                 const std::string& expected) const {
  throw_io_error(file.path, "gives " + tensors_text(describe(outputs)) + "; expected " + expected);
}

std::vector<TensorInfo> describe(const std::vector<NetworkOutput>& outputs) {
  std::vector<TensorInfo> infos;
  for (const NetworkOutput& output : outputs) infos.push_back({output.name, output.shape});
  return infos;
}

bool candidates_are_columns(const std::vector<std::int64_t>& shape, InputSize size) {
  const std::int64_t rows = shape[1];
  const std::int64_t columns = shape[2];
  // Strides 8 to 32, and 64 for the large models; v5 has three candidates a cell, v8 one.
  std::int64_t cells = 0;
  for (int stride = 8; stride <= 64; stride *= 2) {
    cells += static_cast<std::int64_t>((size.width + stride - 1) / stride) *
             ((size.height + stride - 1) / stride);
    if (stride < 32) continue;
    if (rows == 3 * cells) return false;
    if (columns == cells) return true;
  }
  return columns > rows;
}

std::vector<Instance> box_instances(const std::vector<Detection>& detections,
                                    const Letterbox& letterbox) {
  std::vector<Instance> instances;
  for (const Detection& detection : detections) {
    Instance instance;
    instance.box = letterbox.to_image(detection);
    if (instance.box.empty()) continue;
    instance.class_id = detection.class_id;
    instance.score = detection.score;
    instance.mask = cv::Mat(instance.box.size(), CV_8UC1, cv::Scalar(255));
    instances.push_back(std::move(instance));
  }
  return instances;
}

}  // namespace dynslam::segmentation
