#include "dynslam/segmentation/mask_policy.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

void MaskPolicyOptions::validate() const {
  require(min_score >= 0.0F && min_score <= 1.0F, "MaskPolicyOptions", "min_score", min_score,
          "a number from 0 to 1");
  require(dilation_px >= 0 && dilation_px <= 100, "MaskPolicyOptions", "dilation_px", dilation_px,
          "0 to 100 pixels");
  for (const std::string& name : classes) {
    require(!canonical_class_name(name).empty(), "MaskPolicyOptions", "classes", "an empty name",
            "names of classes");
  }
}

MaskPolicy::MaskPolicy(const MaskPolicyOptions& options) : options_(options) {
  options_.validate();
  for (const std::string& name : options_.classes) {
    if (name == "*") {
      every_class_ = true;
    } else {
      canonical_.push_back(canonical_class_name(name));
    }
  }
}

bool MaskPolicy::is_dynamic(const Instance& instance,
                            const std::vector<std::string>& class_names) const {
  if (!(instance.score >= options_.min_score)) return false;
  if (every_class_) return true;
  const auto id = static_cast<std::size_t>(instance.class_id);
  if (instance.class_id < 0 || id >= class_names.size()) return false;
  const std::string name = canonical_class_name(class_names[id]);
  return std::find(canonical_.begin(), canonical_.end(), name) != canonical_.end();
}

void MaskPolicy::mask(const Segmentation& segmentation, const std::vector<std::string>& class_names,
                      cv::Mat& mask) const {
  const cv::Rect image(0, 0, segmentation.width, segmentation.height);
  for (const Instance& instance : segmentation.instances) {
    require((instance.box & image) == instance.box && !instance.box.empty(), "MaskPolicy::mask",
            "box",
            std::to_string(instance.box.width) + "x" + std::to_string(instance.box.height) +
                " at " + std::to_string(instance.box.x) + ", " + std::to_string(instance.box.y),
            "a box inside the image");
    require(instance.mask.type() == CV_8UC1 && instance.mask.size() == instance.box.size(),
            "MaskPolicy::mask", "mask",
            std::to_string(instance.mask.cols) + "x" + std::to_string(instance.mask.rows) + " of " +
                cv::typeToString(instance.mask.type()),
            "CV_8UC1 of the box's size");
  }
  mask.create(segmentation.height, segmentation.width, CV_8UC1);
  mask.setTo(0);
  bool any = false;
  for (const Instance& instance : segmentation.instances) {
    if (!is_dynamic(instance, class_names)) continue;
    cv::Mat window = mask(instance.box);
    cv::bitwise_or(window, instance.mask, window);
    any = true;
  }
  if (any) dilate_mask(mask, options_.dilation_px);
}

cv::Mat MaskPolicy::mask(const Segmentation& segmentation,
                         const std::vector<std::string>& class_names) const {
  cv::Mat result;
  mask(segmentation, class_names, result);
  return result;
}

void dilate_mask(cv::Mat& mask, int radius) {
  require(mask.empty() || (mask.dims == 2 && mask.type() == CV_8UC1), "dilate_mask", "mask",
          cv::typeToString(mask.type()), "CV_8UC1 in two dimensions");
  require(radius >= 0 && radius <= 100, "dilate_mask", "radius", radius, "0 to 100 pixels");
  if (mask.empty() || radius == 0) return;
  const int width = mask.cols;
  const int height = mask.rows;

  // How far the next mask pixel of the same column is, capped: two sweeps over the rows.
  const auto cap = static_cast<std::uint8_t>(radius + 1);
  cv::Mat distance(height, width, CV_8UC1);
  const auto sweep = [&](int y, int from) {
    const std::uint8_t* before = from < 0 || from >= height ? nullptr : distance.ptr(from);
    std::uint8_t* here = distance.ptr(y);
    for (int x = 0; x < width; ++x) {
      const std::uint8_t via =
          before == nullptr ? cap : static_cast<std::uint8_t>(std::min<int>(before[x] + 1, cap));
      here[x] = std::min(here[x], via);
    }
  };
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* source = mask.ptr(y);
    std::uint8_t* here = distance.ptr(y);
    for (int x = 0; x < width; ++x) here[x] = source[x] != 0 ? 0 : cap;
    sweep(y, y - 1);
  }
  for (int y = height - 1; y >= 0; --y) sweep(y, y + 1);

  // A pixel is reached if for some dx the column x + dx has a mask pixel within the disc's half
  // height there.
  for (int y = 0; y < height; ++y) {
    const std::uint8_t* column = distance.ptr(y);
    std::uint8_t* out = mask.ptr(y);
    std::fill(out, out + width, std::uint8_t{0});
    for (int dx = -radius; dx <= radius; ++dx) {
      const auto reach =
          static_cast<std::uint8_t>(std::sqrt(static_cast<double>(radius * radius - dx * dx)));
      const int begin = std::max(0, -dx);
      const int end = std::min(width, width - dx);
      for (int x = begin; x < end; ++x) {
        out[x] = static_cast<std::uint8_t>(out[x] | (column[x + dx] <= reach ? 255 : 0));
      }
    }
  }
}

}  // namespace dynslam::segmentation
