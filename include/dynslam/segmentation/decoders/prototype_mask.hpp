// Instance masks from prototypes (YOLACT's idea, used by YOLOv5-seg, v8-seg and YOLO11-seg).
#pragma once

#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/span.hpp"
#include "dynslam/core/tensor_view.hpp"
#include "dynslam/segmentation/letterbox.hpp"

namespace dynslam::segmentation {

/// Buffers that survive from one mask to the next.
struct PrototypeScratch {
  std::vector<float> logits;
  std::vector<float> row;
  std::vector<int> left;
  std::vector<float> weight;
};

/// The mask of one instance: sigmoid(sum over c of coefficients[c] * prototypes[c]) > 0.5, which is
/// the same as the sum > 0, sampled at the pixels of `box`.
///
/// The sum is made only for the prototype cells that `box` (image pixels, inside the image) needs,
/// interpolated bilinearly with pixel centres in the middle (a cell k covers network edges k * s to
/// (k + 1) * s, s = network size / prototype size), and only where neighbouring cells disagree.
/// Returns 8UC1 of the box's size, 0 or 255.
///
/// Throws InvalidArgument if there are not as many coefficients as prototypes, or if a view is
/// empty. O(coefficients x cells in the box + pixels in the box).
cv::Mat prototype_mask(TensorView<const float> prototypes, Span<const float> coefficients,
                       const Letterbox& letterbox, const cv::Rect& box, PrototypeScratch& scratch);

}  // namespace dynslam::segmentation
