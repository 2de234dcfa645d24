#include "truth_segmenter.hpp"

#include "dynslam/segmentation/simple_segmenters.hpp"

namespace dynslam::examples {

segmentation::Segmentation TruthSegmenter::segment(const cv::Mat& image,
                                                   const segmentation::FrameInfo& info) {
  segmentation::require_segmentable("TruthSegmenter::segment", image, info);
  segmentation::Segmentation found;
  found.width = image.cols;
  found.height = image.rows;
  const cv::Mat labels = sequence_.read(info.index).mask;
  if (!labels.empty()) found.instances = segmentation::instances_of_labels(labels);
  return found;
}

segmentation::SegmenterInfo TruthSegmenter::info() const {
  segmentation::SegmenterInfo info;
  info.kind = "truth";
  info.source = sequence_.name();
  return info;
}

}  // namespace dynslam::examples
