// Segmenters without a network: one that finds nothing, one that reads masks
// from files.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// Finds nothing. The null version of the seam: a system with it takes the
/// whole world for static.
class NullSegmenter final : public Segmenter {
 public:
  /// Checks its arguments as every segmenter does and returns no instance.
  /// O(1).
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override { return names_; }
  SegmenterInfo info() const override;

 private:
  std::vector<std::string> names_;
};

/// What a RecordedSegmenter does.
struct RecordedOptions {
  bool missing_is_empty = false;  ///< a frame without a mask file has no instance (else IoError)
};

/// Reads masks that somebody made before: one PNG a frame, found by the frame's
/// name.
///
/// Every non-zero value of a mask is one instance of the class "mover" with
/// score 1, whose `label` is the value; several things of one value are one
/// instance. Masks are 8-bit or 16-bit with one channel; three equal channels
/// are read as one.
class RecordedSegmenter final : public Segmenter {
 public:
  /// `folder`: holds the masks, each named `frame_stem(FrameInfo::name)` +
  /// ".png". Throws IoError if the folder cannot be listed or holds no PNG
  /// file.
  explicit RecordedSegmenter(const std::string& folder, const RecordedOptions& options = {});

  /// Throws IoError naming the file that is missing, unreadable, or of another
  /// size than the image; InvalidArgument if `frame.name` is empty. O(pixels),
  /// allocates the masks.
  Segmentation segment(const cv::Mat& image, const FrameInfo& frame) override;
  const std::vector<std::string>& class_names() const override { return names_; }
  SegmenterInfo info() const override;

 private:
  std::string folder_;
  RecordedOptions options_;
  std::map<std::string, std::string> files_;  ///< stem to path
  std::vector<std::string> names_{"mover"};
};

/// The instances of a label image (8UC1 or 16UC1): one for every non-zero
/// value, smallest value first, class 0, score 1. Throws InvalidArgument for
/// another type. O(pixels), allocates.
std::vector<Instance> instances_of_labels(const cv::Mat& labels);

}  // namespace dynslam::segmentation
