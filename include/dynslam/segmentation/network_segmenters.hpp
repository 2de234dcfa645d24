// Segmenters for networks other than YOLO segmentation. All letterbox or stretch the image to the
// network's input and give boxes in image pixels.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "dynslam/segmentation/segmenter.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

namespace dynslam::segmentation {

/// Which network gives the boxes.
enum class BoxNetwork {
  kYolo,   ///< YOLOv5, v8 or 11 without masks; told by the shape of the output, 1xNx(5+classes) or
           ///< 1x(4+classes)xN
  kYolox,  ///< YOLOX, raw head: 1xNx(5+classes), grids not decoded, pixels 0..255 in BGR
};

/// Boxes from an ONNX file; the mask of an instance is its whole box (P-Yolo). Put a
/// `RefinedSegmenter` with `masks_from_boxes` around it to get masks from depth; `make_segmenter`
/// does that.
class BoxSegmenter final : public Segmenter {
 public:
  /// Throws as `YoloSegSegmenter`.
  BoxSegmenter(const std::string& model_file, BoxNetwork kind, const NetworkOptions& options = {});
  ~BoxSegmenter() override;
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Boxes from a Darknet network (YOLOv3/v4-tiny, yolo-fastest), with OpenCV only. Masks as
/// `BoxSegmenter`.
class DarknetSegmenter final : public Segmenter {
 public:
  /// Throws IoError naming the file that cannot be read, has no [net] section with width and height
  /// or no [yolo] section with classes, has fewer weights than the layers need, or that OpenCV
  /// refuses; InvalidArgument for bad options and
  /// for another backend than OpenCV.
  DarknetSegmenter(const std::string& cfg_file, const std::string& weights_file,
                   const NetworkOptions& options = {});
  ~DarknetSegmenter() override;
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Mask R-CNN as torchvision exports it to ONNX: outputs boxes [n, 4] (network pixels: left, top,
/// right, bottom), labels [n] (from 1; COCO's 91 numbers), scores [n], and masks [n, 1, m, m] (over
/// the box, m = 28) or [n, 1, height, width] (over the network's input, pasted already).
/// Needs ONNX Runtime: OpenCV cannot run such graphs (for OpenCV see MaskRcnnTensorflowSegmenter).
class MaskRcnnSegmenter final : public Segmenter {
 public:
  /// Throws as `YoloSegSegmenter`.
  explicit MaskRcnnSegmenter(const std::string& model_file, const NetworkOptions& options = {});
  ~MaskRcnnSegmenter() override;
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Mask R-CNN of TensorFlow's object detection API (mask_rcnn_inception_v2_coco and the like), as
/// OpenCV reads it: a frozen graph and the text graph that OpenCV's tf_text_graph_mask_rcnn.py
/// makes for it. Layers detection_out_final [1, 1, n, 7] (image, class from 0, score, left, top,
/// right, bottom as shares of the input) and detection_masks [n, classes, m, m] (over the box).
/// The image is stretched to the input, RGB 0..255. OpenCV only.
class MaskRcnnTensorflowSegmenter final : public Segmenter {
 public:
  /// `config_file` may be empty for a graph that OpenCV understands without. The input is 800 x 800
  /// pixels unless the options say otherwise. Throws IoError naming the file that cannot be read or
  /// that OpenCV refuses, and for other outputs; InvalidArgument for bad options, another backend,
  /// and for class names of another number than the masks have.
  MaskRcnnTensorflowSegmenter(const std::string& graph_file, const std::string& config_file,
                              const NetworkOptions& options = {});
  ~MaskRcnnTensorflowSegmenter() override;
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// A semantic network (DeepLab, LR-ASPP, FCN): one output 1 x classes x h x w of scores, class 0
/// the background, pixels normalized with ImageNet's mean and deviation. One instance a class.
class SemanticSegmenter final : public Segmenter {
 public:
  /// Throws as `YoloSegSegmenter`.
  explicit SemanticSegmenter(const std::string& model_file, const NetworkOptions& options = {});
  ~SemanticSegmenter() override;
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override;
  SegmenterInfo info() const override;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// COCO's 91 numbers, unused ones "n/a", 0 the background; and the 21 classes of Pascal VOC.
const std::vector<std::string>& coco91_class_names();
const std::vector<std::string>& voc_class_names();

}  // namespace dynslam::segmentation
