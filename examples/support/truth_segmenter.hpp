// A segmenter that knows the answer, and at once an example of how little it takes to write one.
#pragma once

#include <string>
#include <vector>

#include "dynslam/dataset/sequence.hpp"
#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::examples {

/// The true labels of a frame as instances; none if it has no labels.
segmentation::Segmentation true_segmentation(const dataset::Frame& frame);

/// Gives the true labels of a sequence as instances of the class "mover", those of a rendered scene
/// for example; finds nothing in frames without labels.
class TruthSegmenter final : public segmentation::Segmenter {
 public:
  /// `sequence` has to outlive the segmenter.
  explicit TruthSegmenter(const dataset::Sequence& sequence) : sequence_(sequence) {}

  /// Reads the frame `info.index` of the sequence again, for its labels alone; who has the frame
  /// asks `true_segmentation`.
  segmentation::Segmentation segment(const cv::Mat& image,
                                     const segmentation::FrameInfo& info) override;
  const std::vector<std::string>& class_names() const override { return names_; }
  segmentation::SegmenterInfo info() const override;

 private:
  const dataset::Sequence& sequence_;
  std::vector<std::string> names_{"mover"};
};

}  // namespace dynslam::examples
