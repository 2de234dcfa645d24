// YOLO instance segmentation from an ONNX file.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// Who runs the network.
enum class Backend {
  kOpenCv,       ///< OpenCV's dnn module, always there
  kOnnxRuntime,  ///< ONNX Runtime, if dynslam was built with it
};

/// How a network runs and which of its detections are kept.
struct NetworkOptions {
  Backend backend = Backend::kOpenCv;
  int threads = 0;               ///< of ONNX Runtime inside one forward; 0 = its own choice;
                                 ///< OpenCV has its own
  float score_threshold = 0.3F;  ///< detections below are dropped; 0..1 (engineering)
  float nms_threshold = 0.45F;   ///< IoU above which the weaker of one class goes (YOLOv5's value)
  int max_instances = 100;       ///< best ones that are kept, > 0 (engineering)
  int input_width = 0;           ///< pixels, only for a model whose file leaves its input size open
  int input_height = 0;          ///< pixels, only for a model whose file leaves its input size open
  std::vector<std::string> class_names;  ///< empty: the model's own, else COCO's if it has 80

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// YOLOv5-seg, YOLOv8-seg or YOLO11-seg; which one is told by the shapes of the
/// outputs: detections [1, N, 5 + classes + 32] (v5: cx, cy, w, h, objectness,
/// classes, coefficients) or [1, 4 + classes + 32, N] (v8 and later, no
/// objectness), and prototypes [1, 32, H / 4, W / 4].
///
/// The image is scaled to fit the network's input, centred on grey 114
/// (letterbox), RGB 0..1. Score = objectness x best class; per-class
/// non-maximum suppression; mask = sigmoid(coefficients . prototypes) > 0.5,
/// interpolated bilinearly to image pixels and cut at the box.
class YoloSegSegmenter final : public Segmenter {
 public:
  /// Loads the model and runs it once, so that the first frame is as fast as
  /// the others. Throws InvalidArgument for bad options; IoError naming the
  /// file if it cannot be read, is not an ONNX model, has other inputs or
  /// outputs (says which were found and expected), or needs a backend that is
  /// not there.
  explicit YoloSegSegmenter(const std::string& model_file, const NetworkOptions& options = {});
  ~YoloSegSegmenter() override;

  /// As `Segmenter::segment`. Cost: one forward of the network; letterbox
  /// O(pixels); decoding O(N + 32 x prototype cells inside the boxes),
  /// allocates the masks.
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The 80 classes of COCO, in the order of the usual networks.
const std::vector<std::string>& coco_class_names();

}  // namespace dynslam::segmentation
