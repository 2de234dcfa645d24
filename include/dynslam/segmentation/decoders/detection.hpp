// Boxes as networks give them, before they become instances.
#pragma once

#include <vector>

namespace dynslam::segmentation {

/// One box of a network. Network pixels measured along edges: the first pixel reaches from 0 to 1.
struct Detection {
  int class_id = 0;
  float score = 0.0F;
  float left = 0.0F;
  float top = 0.0F;
  float right = 0.0F;   ///< > left
  float bottom = 0.0F;  ///< > top
  int index = 0;        ///< which of the network's candidates this was
};

/// Intersection over union of two boxes; 0 if they do not touch.
float box_iou(const Detection& a, const Detection& b);

/// Greedy non-maximum suppression inside each class: sorted by score (ties by `index`, so that the
/// result does not depend on the order of the input), a box goes if its IoU with a better one of
/// its class is above `iou_threshold`; at most `max_count` stay, best first. In place.
/// O(n log n + n x kept).
void suppress_non_maxima(std::vector<Detection>& detections, float iou_threshold, int max_count);

}  // namespace dynslam::segmentation
