#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

#include <algorithm>
#include <utility>

#include "dynslam/segmentation/decoders/prototype_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"

#include "segmentation/loaded_model.hpp"
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

YoloSegLayout recognise(const std::vector<NetworkOutput>& outputs, const LoadedModel& model) {
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
    layout.candidates_are_columns = candidates_are_columns(shape, model.size);
    const std::int64_t values = layout.candidates_are_columns ? shape[1] : shape[2];
    layout.classes =
        static_cast<int>(values - layout.coefficients - (layout.candidates_are_columns ? 4 : 5));
    fits = layout.classes >= 1 && prototypes[2] >= 1 && prototypes[3] >= 1;
  }
  if (!fits) {
    model.refuse_outputs(outputs,
                         "the outputs of YOLO segmentation: detections 1xNx(5+classes+32) (v5) or "
                         "1x(4+classes+32)xN (v8, 11) and prototypes 1x32xHEIGHTxWIDTH");
  }
  return layout;
}

}  // namespace

struct YoloSegSegmenter::Impl {
  LoadedModel model;
  YoloSegLayout layout;
  std::vector<Detection> detections;
  std::vector<float> coefficients;
  PrototypeScratch scratch;

  void decode(const std::vector<NetworkOutput>& outputs, const Letterbox& letterbox,
              std::vector<Instance>& instances);
};

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
    decode_yolov8(matrix, layout.classes, model.options.score_threshold, detections);
  } else {
    decode_yolov5(matrix, layout.classes, model.options.score_threshold, detections);
  }
  suppress_non_maxima(detections, model.options.nms_threshold, model.options.max_instances);

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
  LoadedModel& model = impl_->model;
  impl_->layout = recognise(model.load(model_file, options), model);
  model.info.kind = impl_->layout.candidates_are_columns ? "yolov8-seg" : "yolov5-seg";
  model.names = choose_class_names(model_file, impl_->layout.classes, options.class_names,
                                   class_names_of(model.file));
}

YoloSegSegmenter::~YoloSegSegmenter() = default;

Segmentation YoloSegSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("YoloSegSegmenter::segment", image, frame);
  Segmentation result;
  const Letterbox letterbox = impl_->model.letterbox(image, LetterboxPlace::kCentre);
  const auto& outputs = impl_->model.run(image, letterbox, PixelScale{}, result);
  impl_->decode(outputs, letterbox, result.instances);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& YoloSegSegmenter::class_names() const { return impl_->model.names; }

SegmenterInfo YoloSegSegmenter::info() const { return impl_->model.info; }

}  // namespace dynslam::segmentation
