#include "truth_segmenter.hpp"

#include "dynslam/segmentation/simple_segmenters.hpp"

namespace dynslam::examples {

segmentation::Segmentation true_segmentation(const dataset::Frame& frame) {
  segmentation::Segmentation found;
  found.width = frame.color.cols;
  found.height = frame.color.rows;
  if (!frame.mask.empty()) found.instances = segmentation::instances_of_labels(frame.mask);
  return found;
}

segmentation::Segmentation TruthSegmenter::segment(const cv::Mat& image,
                                                   const segmentation::FrameInfo& info) {
  segmentation::require_segmentable("TruthSegmenter::segment", image, info);
  return true_segmentation(sequence_.read(info.index));
}

segmentation::SegmenterInfo TruthSegmenter::info() const {
  segmentation::SegmenterInfo info;
  info.kind = "truth";
  info.source = sequence_.name();
  return info;
}

}  // namespace dynslam::examples
