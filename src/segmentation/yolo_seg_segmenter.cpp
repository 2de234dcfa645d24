#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

#include <algorithm>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/prototype_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"

#include "segmentation/network.hpp"
#include "segmentation/stopwatch.hpp"

namespace dynslam::segmentation {
namespace {

// Which outputs are what, told by their shapes.
struct YoloSegLayout {
  std::size_t detections = 0;
  std::size_t prototypes = 0;
  bool candidates_are_columns = false;  // v8 and later
  int classes = 0;
  int coefficients = 0;
};

std::vector<TensorInfo> describe(const std::vector<NetworkOutput>& outputs) {
  std::vector<TensorInfo> infos;
  for (const NetworkOutput& output : outputs) infos.push_back({output.name, output.shape});
  return infos;
}

// Grid cells of strides 8, 16, 32 (and 64 for the large models).
std::int64_t cell_count(InputSize size, int last_stride) {
  std::int64_t count = 0;
  for (int stride = 8; stride <= last_stride; stride *= 2) {
    const std::int64_t columns = (size.width + stride - 1) / stride;
    count += columns * ((size.height + stride - 1) / stride);
  }
  return count;
}

// v5 has three candidates a cell, one a row; v8 has one a cell, one a column. Where the numbers fit
// neither, there are more candidates than values of each.
bool are_columns(std::int64_t rows, std::int64_t columns, InputSize size) {
  for (const int last_stride : {32, 64}) {
    const std::int64_t cells = cell_count(size, last_stride);
    if (rows == 3 * cells) return false;
    if (columns == cells) return true;
  }
  return columns > rows;
}

YoloSegLayout recognise(const std::vector<NetworkOutput>& outputs, InputSize size,
                        const std::string& path) {
  YoloSegLayout layout;
  int found_detections = 0;
  int found_prototypes = 0;
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const auto& shape = outputs[i].shape;
    if (shape.size() == 3 && shape[0] == 1) {
      layout.detections = i;
      ++found_detections;
    } else if (shape.size() == 4 && shape[0] == 1) {
      layout.prototypes = i;
      ++found_prototypes;
    }
  }
  bool fits = found_detections == 1 && found_prototypes == 1;
  if (fits) {
    const auto& shape = outputs[layout.detections].shape;
    const auto& prototypes = outputs[layout.prototypes].shape;
    layout.coefficients = static_cast<int>(prototypes[1]);
    layout.candidates_are_columns = are_columns(shape[1], shape[2], size);
    const std::int64_t values = layout.candidates_are_columns ? shape[1] : shape[2];
    layout.classes =
        static_cast<int>(values - layout.coefficients - (layout.candidates_are_columns ? 4 : 5));
    fits = layout.classes >= 1 && prototypes[2] >= 1 && prototypes[3] >= 1;
  }
  if (!fits) {
    throw_io_error(path, "gives " + tensors_text(describe(outputs)) +
                             "; expected the outputs of YOLO segmentation: detections "
                             "1xNx(5+classes+32) (v5) or 1x(4+classes+32)xN (v8, 11) and "
                             "prototypes 1x32xHEIGHTxWIDTH");
  }
  return layout;
}

}  // namespace

struct YoloSegSegmenter::Impl {
  NetworkOptions options;
  OnnxFile file;
  InputSize size;
  std::unique_ptr<Network> network;
  YoloSegLayout layout;
  std::vector<std::string> names;
  SegmenterInfo info;

  std::vector<float> blob;
  std::vector<cv::Mat> planes;
  std::vector<Detection> detections;
  std::vector<float> coefficients;
  PrototypeScratch scratch;

  void load(const std::string& model_file);
  void decode(const std::vector<NetworkOutput>& outputs, const Letterbox& letterbox,
              std::vector<Instance>& instances);
};

void YoloSegSegmenter::Impl::load(const std::string& model_file) {
  file = read_onnx_file(model_file);
  size = input_size_of(file, options);
  network = make_network(file, options, size);
  // The first forward sets up buffers, and shows the shapes that the file may leave open.
  blob.assign(static_cast<std::size_t>(size.width) * static_cast<std::size_t>(size.height) * 3,
              0.5F);
  const auto& outputs = network->run(blob.data());
  layout = recognise(outputs, size, file.path);
  names = choose_class_names(file.path, layout.classes, options.class_names, class_names_of(file));
  info.kind = layout.candidates_are_columns ? "yolov8-seg" : "yolov5-seg";
  info.source = file.path;
  info.sha256 = file.sha256;
  info.backend = network->backend();
  info.inputs = file.inputs;
  info.outputs = describe(outputs);
  file.bytes.clear();
  file.bytes.shrink_to_fit();
}

void YoloSegSegmenter::Impl::decode(const std::vector<NetworkOutput>& outputs,
                                    const Letterbox& letterbox, std::vector<Instance>& instances) {
  const NetworkOutput& boxes = outputs[layout.detections];
  const NetworkOutput& protos = outputs[layout.prototypes];
  const MatrixView matrix(boxes.data, static_cast<int>(boxes.shape[2]),
                          static_cast<int>(boxes.shape[1]));
  const TensorView<const float> prototypes(protos.data, static_cast<int>(protos.shape[1]),
                                           static_cast<int>(protos.shape[2]),
                                           static_cast<int>(protos.shape[3]));
  detections.clear();
  if (layout.candidates_are_columns) {
    decode_yolov8(matrix, layout.classes, options.score_threshold, detections);
  } else {
    decode_yolov5(matrix, layout.classes, options.score_threshold, detections);
  }
  suppress_non_maxima(detections, options.nms_threshold, options.max_instances);

  const int first = layout.classes + (layout.candidates_are_columns ? 4 : 5);
  coefficients.resize(static_cast<std::size_t>(layout.coefficients));
  for (const Detection& detection : detections) {
    Instance instance;
    instance.box = letterbox.to_image(detection);
    if (instance.box.empty()) continue;
    for (int c = 0; c < layout.coefficients; ++c) {
      coefficients[static_cast<std::size_t>(c)] = layout.candidates_are_columns
                                                      ? matrix(detection.index, first + c)
                                                      : matrix(first + c, detection.index);
    }
    instance.class_id = detection.class_id;
    instance.score = detection.score;
    instance.mask = prototype_mask(prototypes, coefficients, letterbox, instance.box, scratch);
    instances.push_back(std::move(instance));
  }
}

YoloSegSegmenter::YoloSegSegmenter(const std::string& model_file, const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  impl_->options = options;
  impl_->load(model_file);
}

YoloSegSegmenter::~YoloSegSegmenter() = default;

Segmentation YoloSegSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("YoloSegSegmenter::segment", image, frame);
  Segmentation result;
  result.width = image.cols;
  result.height = image.rows;
  const Letterbox letterbox =
      make_letterbox(image.size(), cv::Size(impl_->size.width, impl_->size.height));
  fill_input(image, letterbox, PixelScale{}, impl_->blob, impl_->planes);
  const Stopwatch forward;
  const auto& outputs = impl_->network->run(impl_->blob.data());
  result.network_ms = forward.ms();
  impl_->decode(outputs, letterbox, result.instances);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& YoloSegSegmenter::class_names() const { return impl_->names; }

SegmenterInfo YoloSegSegmenter::info() const { return impl_->info; }

}  // namespace dynslam::segmentation
