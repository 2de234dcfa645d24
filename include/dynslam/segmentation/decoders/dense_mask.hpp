// Masks that networks give as images: one a detection (Mask R-CNN), or one for the whole image
// (semantic segmentation).
#pragma once

#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/tensor_view.hpp"
#include "dynslam/segmentation/letterbox.hpp"
#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// The mask of one detection from a small probability image that covers its box (28 x 28 for
/// Mask R-CNN): probability > `threshold`, interpolated bilinearly with pixel centres in the
/// middle, at the pixels of `box`. `detection` is in network pixels, `box` in image pixels. Returns
/// 8UC1 of the box's size, 0 or 255. Throws InvalidArgument if a view or the box is empty.
/// O(pixels).
cv::Mat paste_mask(ImageView<const float> probability, const Detection& detection,
                   const Letterbox& letterbox, const cv::Rect& box, float threshold = 0.5F);

/// Instances of a semantic map: scores (any monotonous ones, logits or probabilities) classes x
/// height x width over the network's input, interpolated to image pixels by nearest cell. One
/// instance for every class that is somewhere the best and is not `background`; its score is the
/// mean softmax probability of its cells. Largest class id last. Throws InvalidArgument if the view
/// is empty or has more than 255 classes. O(classes x cells + pixels).
std::vector<Instance> decode_semantic(TensorView<const float> scores, const Letterbox& letterbox,
                                      int background = 0);

}  // namespace dynslam::segmentation
