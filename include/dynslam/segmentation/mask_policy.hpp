// From instances to the one mask that the rest of a system uses.
#pragma once

#include <string>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/segmentation/segmenter.hpp"

namespace dynslam::segmentation {

/// Classes that may move by themselves: people, vehicles and animals of COCO
/// (person, bicycle, car, motorcycle, bus, train, truck, bird, cat, dog, horse,
/// sheep, cow, elephant, bear, zebra, giraffe), and "mover", the class of
/// recorded masks.
const std::vector<std::string>& default_dynamic_classes();

/// Which instances are dynamic, and how far their mask reaches.
struct MaskPolicyOptions {
  /// Names of the classes that count as dynamic; case, '-' and '_' do not
  /// matter and the two spellings of COCO (motorcycle/motorbike,
  /// airplane/aeroplane, couch/sofa, ...) are the same class. Names that a
  /// segmenter does not know are ignored; "*" stands for every class.
  std::vector<std::string> classes = default_dynamic_classes();
  /// Names of classes that move only when somebody touches them (a chair, a bag): such an instance
  /// is dynamic if its mask comes within `touch_px` of the mask of a dynamic one. Spelled as
  /// `classes`.
  std::vector<std::string> touched_classes;
  int touch_px = 5;        ///< 0..100 (engineering)
  float min_score = 0.3F;  ///< instances below are ignored; 0..1 (engineering)
  int dilation_px = 3;     ///< the mask grows by this many pixels, 0..255 (ORB
                           ///< patches reach over)

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Turns a segmentation into a dynamic mask.
///
/// Thread-safety: const after construction, any number of threads.
class MaskPolicy {
 public:
  /// Throws InvalidArgument for bad options.
  explicit MaskPolicy(const MaskPolicyOptions& options = {});

  const MaskPolicyOptions& options() const { return options_; }

  /// Whether an instance counts as dynamic by class and score. A `class_id`
  /// outside `class_names` only matches "*".
  bool is_dynamic(const Instance& instance, const std::vector<std::string>& class_names) const;

  /// Which instances are dynamic: by class and score, and those of the touched classes that a
  /// dynamic one touches (once: what is touched does not pass it on). Indices, ascending. Throws as
  /// `mask`.
  std::vector<std::size_t> dynamic_instances(const Segmentation& segmentation,
                                             const std::vector<std::string>& class_names) const;

  /// Union of the dynamic instances' masks, dilated: 8UC1 of the segmented
  /// image's size, 0 static, 255 dynamic. Written into `mask`, which is reused
  /// if it has the size already. `as_view<const std::uint8_t>(mask)` is the
  /// MaskView that other rooms take.
  ///
  /// Throws InvalidArgument if an instance's box leaves the image or its mask
  /// has another size or type than its box. Cost O(pixels), allocates scratch
  /// only to dilate.
  void mask(const Segmentation& segmentation, const std::vector<std::string>& class_names,
            cv::Mat& mask) const;

  /// The same, in a new image.
  cv::Mat mask(const Segmentation& segmentation, const std::vector<std::string>& class_names) const;

 private:
  MaskPolicyOptions options_;
  bool in_list(const Instance& instance, const std::vector<std::string>& class_names,
               const std::vector<std::string>& list) const;

  std::vector<std::string> canonical_;
  std::vector<std::string> touched_;
  bool every_class_ = false;
};

/// The one spelling of a class name that all its spellings share: lower case,
/// spaces for '-' and
/// '_', and the names of today's COCO lists ("motorbike" gives "motorcycle").
std::string canonical_class_name(const std::string& name);

/// Grows the non-zero region of an 8UC1 mask in place to all pixels within
/// `radius` (Euclidean disc). O(pixels x radius) with OpenCV's filters; nothing
/// for radius 0.
void dilate_mask(cv::Mat& mask, int radius);

/// How far a mask must reach at a level of an image pyramid so that a descriptor patch of
/// `patch_radius` pixels of that level stays off it: ceil(patch_radius * scale^level) pixels of the
/// full image, at most 100 (ORB: radius 15, scale 1.2). Throws InvalidArgument for a negative
/// radius or level or a scale below 1.
int dilation_at_level(double patch_radius, double scale, int level);

/// The mask for every level of an image pyramid: level l has the size round(size / scale^l) and is
/// 255 where a patch of `patch_radius` pixels of that level would reach a dynamic pixel
/// (`dilation_at_level`). `mask` is 8UC1. Throws InvalidArgument for another type, for fewer than
/// one level, and as `dilation_at_level`. O(levels x pixels x radius).
std::vector<cv::Mat> masks_by_level(const cv::Mat& mask, double patch_radius, double scale,
                                    int levels);

}  // namespace dynslam::segmentation
