// Mask R-CNN of TensorFlow's object detection API, as OpenCV reads it.
#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/dnn.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/dense_mask.hpp"
#include "dynslam/segmentation/network_segmenters.hpp"

#include "segmentation/loaded_model.hpp"
#include "segmentation/sha256.hpp"

namespace dynslam::segmentation {
namespace {

constexpr int kRow = 7;           // image, class, score, left, top, right, bottom
constexpr int kUsualSize = 800;   // pixels; what OpenCV's own sample runs these graphs at
constexpr int kCocoClasses = 90;  // of the API's models; the background is not among them
const char* const kBoxes = "detection_out_final";
const char* const kMasks = "detection_masks";

TensorInfo info_of(const char* name, const cv::Mat& mat) {
  TensorInfo info;
  info.name = name;
  for (int i = 0; i < mat.dims; ++i) info.shape.push_back(mat.size[i]);
  return info;
}

}  // namespace

struct MaskRcnnTensorflowSegmenter::Impl {
  NetworkOptions options;
  std::string path;
  cv::Size size;
  cv::dnn::Net net;
  std::vector<std::string> names;
  SegmenterInfo info;
  std::vector<float> blob;
  std::vector<cv::Mat> planes;
  std::vector<cv::Mat> outputs;  // boxes, masks

  void load(const std::string& graph, const std::string& config);
  void forward();
  Instance instance(const float* row, int index, const Letterbox& letterbox) const;
  const cv::Mat& boxes() const { return outputs[0]; }
  const cv::Mat& masks() const { return outputs[1]; }
};

void MaskRcnnTensorflowSegmenter::Impl::load(const std::string& graph, const std::string& config) {
  path = graph;
  const std::string bytes = read_file_bytes(graph);
  const std::string text = config.empty() ? "" : read_file_bytes(config);
  info.sha256 = sha256(bytes.data(), bytes.size());
  try {
    net = cv::dnn::readNetFromTensorflow(bytes.data(), bytes.size(),
                                         text.empty() ? nullptr : text.data(), text.size());
  } catch (const cv::Exception& error) {
    throw_io_error(graph, "OpenCV cannot load this network: " + opencv_error_text(error.what()) +
                              (config.empty() ? "" : " (with " + config + ")"));
  }
  if (net.empty() || net.getLayerId(kBoxes) < 0 || net.getLayerId(kMasks) < 0) {
    throw_io_error(graph, std::string("has no layers ") + kBoxes + " and " + kMasks +
                              "; expected Mask R-CNN of TensorFlow's object detection API");
  }
}

void MaskRcnnTensorflowSegmenter::Impl::forward() {
  const int shape[4] = {1, 3, size.height, size.width};
  try {
    net.setInput(cv::Mat(4, shape, CV_32F, blob.data()));
    net.forward(outputs, std::vector<std::string>{kBoxes, kMasks});
  } catch (const cv::Exception& error) {
    throw_io_error(path, "OpenCV cannot run this network: " + opencv_error_text(error.what()));
  }
  const bool fits = boxes().dims == 4 && boxes().size[0] == 1 && boxes().size[1] == 1 &&
                    boxes().size[3] == kRow && boxes().type() == CV_32F && masks().dims == 4 &&
                    masks().type() == CV_32F && masks().size[0] >= boxes().size[2] &&
                    masks().size[1] >= 1;
  if (!fits) {
    throw_io_error(path, "gives " +
                             tensors_text({info_of(kBoxes, boxes()), info_of(kMasks, masks())}) +
                             "; expected 1x1xNx7 and NxCLASSESxHEIGHTxWIDTH");
  }
}

Instance MaskRcnnTensorflowSegmenter::Impl::instance(const float* row, int index,
                                                     const Letterbox& letterbox) const {
  Instance instance;
  const auto width = static_cast<float>(size.width);
  const auto height = static_cast<float>(size.height);
  const Detection box{0,    0.0F, row[3] * width, row[4] * height, row[5] * width, row[6] * height,
                      index};
  const int classes = masks().size[1];
  const bool valid = std::isfinite(box.left) && std::isfinite(box.top) &&
                     std::isfinite(box.right) && std::isfinite(box.bottom) &&
                     box.right > box.left && box.bottom > box.top && row[1] >= 0.0F &&
                     row[1] < static_cast<float>(classes);
  if (!valid) return instance;
  instance.box = letterbox.to_image(box);
  if (instance.box.empty()) return instance;
  instance.class_id = static_cast<int>(row[1]);
  instance.score = row[2];
  const ImageView<const float> probability(masks().ptr<float>(index, instance.class_id),
                                           masks().size[3], masks().size[2]);
  instance.mask = paste_mask(probability, box, letterbox, instance.box);
  return instance;
}

MaskRcnnTensorflowSegmenter::MaskRcnnTensorflowSegmenter(const std::string& graph_file,
                                                         const std::string& config_file,
                                                         const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  require(options.backend == Backend::kOpenCv, "MaskRcnnTensorflowSegmenter", "backend",
          "onnxruntime", "opencv, the only one that reads TensorFlow graphs");
  Impl& self = *impl_;
  self.options = options;
  self.size = options.input_width > 0 ? cv::Size(options.input_width, options.input_height)
                                      : cv::Size(kUsualSize, kUsualSize);
  self.load(graph_file, config_file);
  self.blob.assign(static_cast<std::size_t>(self.size.area()) * 3, 114.0F);
  self.forward();
  const int classes = self.masks().size[1];
  std::vector<std::string> own;
  if (classes == kCocoClasses) {
    own.assign(coco91_class_names().begin() + 1, coco91_class_names().end());
  }
  self.names = choose_class_names(graph_file, classes, options.class_names, own);
  self.info.kind = "mask-rcnn";
  self.info.source = graph_file;
  self.info.backend = "opencv";
  self.info.inputs = {{"image", {1, 3, self.size.height, self.size.width}}};
  self.info.outputs = {info_of(kBoxes, self.boxes()), info_of(kMasks, self.masks())};
}

MaskRcnnTensorflowSegmenter::~MaskRcnnTensorflowSegmenter() = default;

Segmentation MaskRcnnTensorflowSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("MaskRcnnTensorflowSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation result;
  result.width = image.cols;
  result.height = image.rows;
  const Letterbox letterbox = make_letterbox(image.size(), self.size, LetterboxPlace::kStretch);
  PixelScale pixels;  // these graphs scale by themselves
  std::fill(std::begin(pixels.factor), std::end(pixels.factor), 1.0F);
  fill_input(image, letterbox, pixels, self.blob, self.planes);
  const Stopwatch forward;
  self.forward();
  result.network_ms = forward.ms();
  for (int i = 0; i < self.boxes().size[2]; ++i) {
    const float* row = self.boxes().ptr<float>() + static_cast<std::ptrdiff_t>(i) * kRow;
    if (!(row[2] >= self.options.score_threshold)) continue;
    Instance instance = self.instance(row, i, letterbox);
    if (!instance.box.empty()) result.instances.push_back(std::move(instance));
  }
  std::stable_sort(result.instances.begin(), result.instances.end(),
                   [](const Instance& a, const Instance& b) { return a.score > b.score; });
  const auto limit = static_cast<std::size_t>(self.options.max_instances);
  if (result.instances.size() > limit) result.instances.resize(limit);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& MaskRcnnTensorflowSegmenter::class_names() const {
  return impl_->names;
}
SegmenterInfo MaskRcnnTensorflowSegmenter::info() const { return impl_->info; }

}  // namespace dynslam::segmentation
