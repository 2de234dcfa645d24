#include "dynslam/segmentation/decoders/detection.hpp"

#include <algorithm>

namespace dynslam::segmentation {

float box_iou(const Detection& a, const Detection& b) {
  const float width = std::min(a.right, b.right) - std::max(a.left, b.left);
  const float height = std::min(a.bottom, b.bottom) - std::max(a.top, b.top);
  if (!(width > 0.0F) || !(height > 0.0F)) return 0.0F;
  const float both = width * height;
  const float area_a = (a.right - a.left) * (a.bottom - a.top);
  const float area_b = (b.right - b.left) * (b.bottom - b.top);
  return both / (area_a + area_b - both);
}

void suppress_non_maxima(std::vector<Detection>& detections, float iou_threshold, int max_count) {
  std::sort(detections.begin(), detections.end(), [](const Detection& a, const Detection& b) {
    return a.score != b.score ? a.score > b.score : a.index < b.index;
  });
  std::size_t kept = 0;
  const std::size_t limit = max_count > 0 ? static_cast<std::size_t>(max_count) : 0;
  for (std::size_t i = 0; i < detections.size() && kept < limit; ++i) {
    const Detection candidate = detections[i];
    bool keep = true;
    for (std::size_t k = 0; k < kept && keep; ++k) {
      keep = detections[k].class_id != candidate.class_id ||
             !(box_iou(detections[k], candidate) > iou_threshold);
    }
    if (keep) detections[kept++] = candidate;
  }
  detections.resize(kept);
}

}  // namespace dynslam::segmentation
