// The map between an image and a network's input.
#pragma once

#include <vector>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/segmentation/decoders/detection.hpp"

namespace dynslam::segmentation {

/// An image scaled by one factor to fit a network's input and surrounded with grey. Measured along
/// edges, network = image * scale + offset in each direction; as `scale_x` and `scale_y` differ
/// only by the rounding to whole pixels, shapes are kept.
struct Letterbox {
  cv::Size image;        ///< pixels
  cv::Size network;      ///< pixels
  cv::Rect inner;        ///< where the scaled image lies in the network's input
  double scale_x = 1.0;  ///< inner.width / image.width
  double scale_y = 1.0;  ///< inner.height / image.height

  /// The image pixels that a network box touches, cut at the image; may be empty.
  cv::Rect to_image(const Detection& box) const;
};

/// Where the scaled image goes.
enum class LetterboxPlace {
  kCentre,     ///< YOLOv5, v8: equal borders
  kUpperLeft,  ///< YOLOX: border at the right and below
  kStretch,    ///< Darknet: no border, each direction has its own scale
};

/// The map for images of size `image` (both sizes above zero; else InvalidArgument).
Letterbox make_letterbox(cv::Size image, cv::Size network,
                         LetterboxPlace place = LetterboxPlace::kCentre);

/// How pixels become numbers: value = (pixel - mean) * factor, channel by channel.
struct PixelScale {
  bool rgb = true;                                         ///< order of the planes; false = BGR
  float factor[3] = {1.0F / 255, 1.0F / 255, 1.0F / 255};  ///< in the order of the planes
  float mean[3] = {0.0F, 0.0F, 0.0F};                      ///< in the order of the planes
  float border = 114.0F;                                   ///< pixel value of the border
};

/// The network's input, 3 x height x width (CHW): scaled bilinearly, border filled. `image` is 8UC1
/// (all planes alike), 8UC3 (BGR) or 8UC4 (BGRA) of the letterbox's size. `blob` and `scratch` are
/// resized on the first call and reused. O(pixels).
void fill_input(const cv::Mat& image, const Letterbox& letterbox, const PixelScale& pixels,
                std::vector<float>& blob, std::vector<cv::Mat>& scratch);

}  // namespace dynslam::segmentation
