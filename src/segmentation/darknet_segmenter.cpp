#include <utility>

#include <opencv2/dnn.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"
#include "dynslam/segmentation/network_segmenters.hpp"

#include "segmentation/darknet_cfg.hpp"
#include "segmentation/loaded_model.hpp"
#include "segmentation/sha256.hpp"

namespace dynslam::segmentation {
struct DarknetSegmenter::Impl {
  NetworkOptions options;
  DarknetCfg cfg;
  cv::dnn::Net net;
  std::vector<std::string> outputs;
  std::vector<std::string> names;
  SegmenterInfo info;
  std::string weights;
  std::vector<float> blob;
  std::vector<cv::Mat> planes;
  std::vector<cv::Mat> results;
  std::vector<Detection> detections;

  void forward();
};

void DarknetSegmenter::Impl::forward() {
  const int shape[4] = {1, 3, cfg.height, cfg.width};
  try {
    net.setInput(cv::Mat(4, shape, CV_32F, blob.data()));
    net.forward(results, outputs);
  } catch (const cv::Exception& error) {
    throw_io_error(weights, "OpenCV cannot run this network: " + opencv_error_text(error.what()));
  }
  for (const cv::Mat& result : results) {
    if (result.dims != 2 || result.cols != 5 + cfg.classes || result.type() != CV_32F) {
      throw_io_error(weights, "gives rows of " + std::to_string(result.cols) +
                                  " numbers; expected 5 + " + std::to_string(cfg.classes));
    }
  }
}

DarknetSegmenter::DarknetSegmenter(const std::string& cfg_file, const std::string& weights_file,
                                   const NetworkOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  require(options.backend == Backend::kOpenCv, "DarknetSegmenter", "backend", "onnxruntime",
          "opencv, the only one that reads Darknet networks");
  Impl& self = *impl_;
  self.options = options;
  const std::string cfg_text = read_file_bytes(cfg_file);
  self.cfg = read_darknet_cfg(cfg_file, cfg_text);
  self.weights = weights_file;
  const std::string bytes = read_file_bytes(weights_file);
  require_whole_weights(weights_file, bytes, self.cfg);
  try {
    self.net =
        cv::dnn::readNetFromDarknet(cfg_text.data(), cfg_text.size(), bytes.data(), bytes.size());
    self.outputs = self.net.getUnconnectedOutLayersNames();
  } catch (const cv::Exception& error) {
    throw_io_error(weights_file, "OpenCV cannot load this network: " +
                                     opencv_error_text(error.what()) + " (with " + cfg_file + ")");
  }
  self.blob.assign(
      static_cast<std::size_t>(self.cfg.width) * static_cast<std::size_t>(self.cfg.height) * 3,
      0.5F);
  self.forward();
  self.names = choose_class_names(cfg_file, self.cfg.classes, options.class_names, {});
  self.info.kind = "darknet";
  self.info.source = weights_file;
  self.info.sha256 = sha256(bytes.data(), bytes.size());
  self.info.backend = "opencv";
  self.info.inputs = {{"data", {1, 3, self.cfg.height, self.cfg.width}}};
  for (std::size_t i = 0; i < self.results.size(); ++i) {
    self.info.outputs.push_back({self.outputs[i], {self.results[i].rows, self.results[i].cols}});
  }
}

DarknetSegmenter::~DarknetSegmenter() = default;

Segmentation DarknetSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("DarknetSegmenter::segment", image, frame);
  Impl& self = *impl_;
  Segmentation result;
  result.width = image.cols;
  result.height = image.rows;
  const Letterbox letterbox = make_letterbox(
      image.size(), cv::Size(self.cfg.width, self.cfg.height), LetterboxPlace::kStretch);
  fill_input(image, letterbox, PixelScale{}, self.blob, self.planes);
  const Stopwatch forward;
  self.forward();
  result.network_ms = forward.ms();
  self.detections.clear();
  for (const cv::Mat& rows : self.results) {
    if (rows.rows == 0) continue;
    decode_darknet(MatrixView(rows.ptr<float>(), rows.cols, rows.rows), self.cfg.classes,
                   self.cfg.width, self.cfg.height, self.options.score_threshold, self.detections);
  }
  suppress_non_maxima(self.detections, self.options.nms_threshold, self.options.max_instances);
  result.instances = box_instances(self.detections, letterbox);
  result.total_ms = total.ms();
  return result;
}

const std::vector<std::string>& DarknetSegmenter::class_names() const { return impl_->names; }
SegmenterInfo DarknetSegmenter::info() const { return impl_->info; }

}  // namespace dynslam::segmentation
