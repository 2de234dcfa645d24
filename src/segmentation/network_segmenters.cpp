#include "dynslam/segmentation/network_segmenters.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/dense_mask.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"

#include "segmentation/loaded_model.hpp"

namespace dynslam::segmentation {
namespace {

MatrixView matrix_of(const NetworkOutput& output) {
  return MatrixView(output.data, static_cast<int>(output.shape[2]),
                    static_cast<int>(output.shape[1]));
}

PixelScale imagenet_pixels() {
  PixelScale pixels;
  constexpr float kMean[3] = {0.485F, 0.456F, 0.406F};
  constexpr float kDeviation[3] = {0.229F, 0.224F, 0.225F};
  for (int c = 0; c < 3; ++c) {
    pixels.mean[c] = 255.0F * kMean[c];
    pixels.factor[c] = 1.0F / (255.0F * kDeviation[c]);
  }
  return pixels;
}

}  // namespace

// ------------------------------------------------------------------------------------ boxes

struct BoxSegmenter::Impl {
  LoadedModel model;
  BoxNetwork kind = BoxNetwork::kYolo;
  bool columns = false;
  int classes = 0;
  std::vector<Detection> detections;
};

BoxSegmenter::BoxSegmenter(const std::string& model_file, BoxNetwork kind,
                           const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  Impl& self = *impl_;
  self.kind = kind;
  const auto& outputs = self.model.load(model_file, options);
  const bool yolox = kind == BoxNetwork::kYolox;
  const std::string expected = yolox
                                   ? "one output 1xNx(5+classes), YOLOX's raw head"
                                   : "one output 1xNx(5+classes) (v5) or 1x(4+classes)xN (v8, 11)";
  if (outputs.size() != 1 || outputs[0].shape.size() != 3 || outputs[0].shape[0] != 1) {
    self.model.refuse_outputs(outputs, expected);
  }
  const auto& shape = outputs[0].shape;
  self.columns = !yolox && candidates_are_columns(shape, self.model.size);
  self.classes = static_cast<int>(self.columns ? shape[1] - 4 : shape[2] - 5);
  if (self.classes < 1) self.model.refuse_outputs(outputs, expected);
  if (yolox) {
    std::int64_t cells = 0;
    for (const int stride : {8, 16, 32}) {
      cells += static_cast<std::int64_t>(self.model.size.width / stride) *
               (self.model.size.height / stride);
    }
    if (shape[1] != cells) {
      self.model.refuse_outputs(outputs, expected + " with N = " + std::to_string(cells));
    }
  }
  self.model.info.kind = yolox ? "yolox" : (self.columns ? "yolov8" : "yolov5");
  self.model.names = choose_class_names(model_file, self.classes, options.class_names,
                                        class_names_of(self.model.file));
}

BoxSegmenter::~BoxSegmenter() = default;

Segmentation BoxSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("BoxSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation result;
  const bool yolox = self.kind == BoxNetwork::kYolox;
  PixelScale pixels;
  if (yolox) {
    pixels.rgb = false;
    std::fill(std::begin(pixels.factor), std::end(pixels.factor), 1.0F);
  }
  const Letterbox letterbox =
      self.model.letterbox(image, yolox ? LetterboxPlace::kUpperLeft : LetterboxPlace::kCentre);
  const auto& outputs = self.model.run(image, letterbox, pixels, result);
  const MatrixView matrix = matrix_of(outputs[0]);
  const NetworkOptions& options = self.model.options;
  self.detections.clear();
  if (yolox) {
    decode_yolox(matrix, self.classes, self.model.size.width, self.model.size.height,
                 options.score_threshold, self.detections);
  } else if (self.columns) {
    decode_yolov8(matrix, self.classes, options.score_threshold, self.detections);
  } else {
    decode_yolov5(matrix, self.classes, options.score_threshold, self.detections);
  }
  suppress_non_maxima(self.detections, options.nms_threshold, options.max_instances);
  result.instances = box_instances(self.detections, letterbox);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& BoxSegmenter::class_names() const { return impl_->model.names; }
SegmenterInfo BoxSegmenter::info() const { return impl_->model.info; }

// ------------------------------------------------------------------------------- Mask R-CNN

struct MaskRcnnSegmenter::Impl {
  LoadedModel model;
  std::size_t boxes = 0, labels = 0, scores = 0, masks = 0;

  void recognise(const std::vector<NetworkOutput>& outputs);
  Instance instance(const std::vector<NetworkOutput>& outputs, int i,
                    const Letterbox& letterbox) const;
};

// Boxes are the matrix with four columns, masks the output of four dimensions; labels and scores
// are the two vectors, told apart by their names.
void MaskRcnnSegmenter::Impl::recognise(const std::vector<NetworkOutput>& outputs) {
  int found[4] = {0, 0, 0, 0};
  std::vector<std::size_t> vectors;
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const auto& shape = outputs[i].shape;
    if (shape.size() == 2 && shape[1] == 4) {
      boxes = i;
      ++found[0];
    } else if (shape.size() == 4 && shape[1] == 1) {
      masks = i;
      ++found[1];
    } else if (shape.size() == 1) {
      vectors.push_back(i);
    }
  }
  if (vectors.size() == 2) {
    // torchvision's order is labels, scores.
    const bool swapped = outputs[vectors[0]].name.find("score") != std::string::npos;
    labels = vectors[swapped ? 1 : 0];
    scores = vectors[swapped ? 0 : 1];
  }
  bool fits = found[0] == 1 && found[1] == 1 && vectors.size() == 2 && outputs.size() == 4;
  if (fits) {
    const std::int64_t n = outputs[boxes].shape[0];
    fits = outputs[masks].shape[0] == n && outputs[labels].shape[0] == n &&
           outputs[scores].shape[0] == n;
  }
  if (!fits) {
    model.refuse_outputs(outputs, "Mask R-CNN's: boxes nx4, labels n, scores n, masks nx1xHxW");
  }
}

Instance MaskRcnnSegmenter::Impl::instance(const std::vector<NetworkOutput>& outputs, int i,
                                           const Letterbox& letterbox) const {
  Instance instance;
  const float* box = outputs[boxes].data + static_cast<std::ptrdiff_t>(i) * 4;
  const Detection detection{0, 0.0F, box[0], box[1], box[2], box[3], i};
  const bool finite = std::isfinite(box[0]) && std::isfinite(box[1]) && std::isfinite(box[2]) &&
                      std::isfinite(box[3]);
  if (!finite || !(box[2] > box[0]) || !(box[3] > box[1])) return instance;
  instance.box = letterbox.to_image(detection);
  if (instance.box.empty()) return instance;
  instance.class_id = static_cast<int>(outputs[labels].data[i]);
  instance.score = outputs[scores].data[i];
  const auto height = static_cast<int>(outputs[masks].shape[2]);
  const auto width = static_cast<int>(outputs[masks].shape[3]);
  const ImageView<const float> probability(
      outputs[masks].data + static_cast<std::ptrdiff_t>(i) * height * width, width, height);
  // Masks as large as the input cover the input, small ones the box.
  const bool pasted = width == model.size.width && height == model.size.height;
  const Detection whole{0, 0.0F, 0.0F, 0.0F, static_cast<float>(width), static_cast<float>(height),
                        i};
  instance.mask = paste_mask(probability, pasted ? whole : detection, letterbox, instance.box);
  return instance;
}

MaskRcnnSegmenter::MaskRcnnSegmenter(const std::string& model_file, const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  Impl& self = *impl_;
  self.recognise(self.model.load(model_file, options));
  self.model.info.kind = "mask-rcnn";
  self.model.names = options.class_names;
  if (self.model.names.empty()) self.model.names = class_names_of(self.model.file);
  if (self.model.names.empty()) self.model.names = coco91_class_names();
}

MaskRcnnSegmenter::~MaskRcnnSegmenter() = default;

Segmentation MaskRcnnSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("MaskRcnnSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation result;
  const Letterbox letterbox = self.model.letterbox(image, LetterboxPlace::kCentre);
  const auto& outputs = self.model.run(image, letterbox, PixelScale{}, result);
  self.recognise(outputs);
  const auto count = static_cast<int>(outputs[self.boxes].shape[0]);
  for (int i = 0; i < count; ++i) {
    if (!(outputs[self.scores].data[i] >= self.model.options.score_threshold)) continue;
    Instance instance = self.instance(outputs, i, letterbox);
    if (!instance.box.empty()) result.instances.push_back(std::move(instance));
  }
  std::stable_sort(result.instances.begin(), result.instances.end(),
                   [](const Instance& a, const Instance& b) { return a.score > b.score; });
  const auto limit = static_cast<std::size_t>(self.model.options.max_instances);
  if (result.instances.size() > limit) result.instances.resize(limit);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& MaskRcnnSegmenter::class_names() const {
  return impl_->model.names;
}
SegmenterInfo MaskRcnnSegmenter::info() const { return impl_->model.info; }

// ---------------------------------------------------------------------------- semantic maps

struct SemanticSegmenter::Impl {
  LoadedModel model;
  int classes = 0;
};

SemanticSegmenter::SemanticSegmenter(const std::string& model_file, const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  Impl& self = *impl_;
  const auto& outputs = self.model.load(model_file, options);
  // torchvision adds an auxiliary output of the same shape after the main one.
  const bool fits = !outputs.empty() && outputs[0].shape.size() == 4 && outputs[0].shape[0] == 1 &&
                    outputs[0].shape[1] >= 2 && outputs[0].shape[1] <= 255;
  if (!fits) {
    self.model.refuse_outputs(outputs, "a semantic map 1xCLASSESxHEIGHTxWIDTH of scores");
  }
  self.classes = static_cast<int>(outputs[0].shape[1]);
  self.model.info.kind = "semantic";
  std::vector<std::string> own = class_names_of(self.model.file);
  if (own.empty() && self.classes == 21) own = voc_class_names();
  self.model.names = choose_class_names(model_file, self.classes, options.class_names, own);
}

SemanticSegmenter::~SemanticSegmenter() = default;

Segmentation SemanticSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("SemanticSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation result;
  const Letterbox letterbox = self.model.letterbox(image, LetterboxPlace::kCentre);
  const auto& outputs = self.model.run(image, letterbox, imagenet_pixels(), result);
  const TensorView<const float> scores(outputs[0].data, self.classes,
                                       static_cast<int>(outputs[0].shape[2]),
                                       static_cast<int>(outputs[0].shape[3]));
  for (Instance& instance : decode_semantic(scores, letterbox)) {
    if (instance.score >= self.model.options.score_threshold) {
      result.instances.push_back(std::move(instance));
    }
  }
  std::stable_sort(result.instances.begin(), result.instances.end(),
                   [](const Instance& a, const Instance& b) { return a.score > b.score; });
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& SemanticSegmenter::class_names() const {
  return impl_->model.names;
}
SegmenterInfo SemanticSegmenter::info() const { return impl_->model.info; }

}  // namespace dynslam::segmentation
