#include "dynslam/segmentation/mask_policy.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {
namespace {

void paint(const Instance& instance, cv::Mat& mask) {
  cv::Mat window = mask(instance.box);
  cv::bitwise_or(window, instance.mask, window);
}

// Half the height of a disc in the column that is `dx` off its middle.
int half_height(int radius, int dx) {
  return static_cast<int>(std::sqrt(static_cast<double>(radius * radius - dx * dx)));
}

void dilate_by_filter(cv::Mat& mask, int radius) {
  cv::Mat disc = cv::Mat::zeros(2 * radius + 1, 2 * radius + 1, CV_8UC1);
  for (int dx = -radius; dx <= radius; ++dx) {
    const int reach = half_height(radius, dx);
    disc(cv::Rect(radius + dx, radius - reach, 1, 2 * reach + 1)).setTo(1);
  }
  cv::dilate(mask, mask, disc);
  cv::threshold(mask, mask, 0, 255, cv::THRESH_BINARY);
}

constexpr int kBlock = 64;  // columns at a time, a constant, so that loops over it are vectorized

// How far the next set pixel of the same column is, at most `cap`: two sweeps over the rows.
cv::Mat column_distances(const cv::Mat& mask, std::uint8_t cap) {
  cv::Mat distance(mask.size(), CV_8UC1);
  const int width = mask.cols;
  const auto sweep = [&distance, width, cap](int y, int from) {
    const std::uint8_t* before = distance.ptr(from);
    std::uint8_t* here = distance.ptr(y);
    for (int x = 0; x < width; ++x) {
      const auto via = static_cast<std::uint8_t>(before[x] < cap ? before[x] + 1 : cap);
      here[x] = via < here[x] ? via : here[x];
    }
  };
  for (int y = 0; y < mask.rows; ++y) {
    const std::uint8_t* source = mask.ptr(y);
    std::uint8_t* here = distance.ptr(y);
    for (int x = 0; x < width; ++x) here[x] = source[x] != 0 ? 0 : cap;
    if (y > 0) sweep(y, y - 1);
  }
  for (int y = mask.rows - 2; y >= 0; --y) sweep(y, y + 1);
  return distance;
}

// 255 for those of `kBlock` pixels around which a column `dx` off, to either side, has a set pixel
// within the disc's half height there. `columns`: their distances, `reach[dx]`: the half heights.
void reach_block(const std::uint8_t* columns, const std::vector<std::uint8_t>& reach,
                 std::uint8_t* out) {
  std::uint8_t set[kBlock] = {};
  for (std::size_t dx = 0; dx < reach.size(); ++dx) {
    const std::uint8_t* left = columns - dx;
    const std::uint8_t* right = columns + dx;
    const std::uint8_t height = reach[dx];
    for (int x = 0; x < kBlock; ++x) {
      const std::uint8_t nearer = left[x] < right[x] ? left[x] : right[x];
      set[x] = static_cast<std::uint8_t>(set[x] | (nearer <= height ? 255 : 0));
    }
  }
  std::copy_n(set, kBlock, out);
}

void dilate_by_columns(cv::Mat& mask, int radius) {
  std::vector<std::uint8_t> reach;
  for (int dx = 0; dx <= radius; ++dx) {
    reach.push_back(static_cast<std::uint8_t>(half_height(radius, dx)));
  }
  const auto cap = static_cast<std::uint8_t>(radius + 1);
  const cv::Mat distance = column_distances(mask, cap);
  // A row with room for what blocks reach beyond its ends, where nothing is set.
  const std::size_t blocks = (static_cast<std::size_t>(mask.cols) + kBlock - 1) / kBlock;
  std::vector<std::uint8_t> columns(blocks * kBlock + 2 * reach.size(), cap);
  std::vector<std::uint8_t> row(blocks * kBlock);
  for (int y = 0; y < mask.rows; ++y) {
    std::copy_n(distance.ptr(y), mask.cols, columns.data() + reach.size());
    for (std::size_t x = 0; x < row.size(); x += kBlock) {
      reach_block(columns.data() + reach.size() + x, reach, row.data() + x);
    }
    std::copy_n(row.data(), mask.cols, mask.ptr(y));
  }
}

}  // namespace

void MaskPolicyOptions::validate() const {
  require(min_score >= 0.0F && min_score <= 1.0F, "MaskPolicyOptions", "min_score", min_score,
          "a number from 0 to 1");
  require(dilation_px >= 0 && dilation_px <= 100, "MaskPolicyOptions", "dilation_px", dilation_px,
          "0 to 100 pixels");
  require(touch_px >= 0 && touch_px <= 100, "MaskPolicyOptions", "touch_px", touch_px,
          "0 to 100 pixels");
  const auto check_names = [](const std::vector<std::string>& names, const char* member) {
    for (const std::string& name : names) {
      require(!canonical_class_name(name).empty(), "MaskPolicyOptions", member, "an empty name",
              "names of classes");
    }
  };
  check_names(classes, "classes");
  check_names(touched_classes, "touched_classes");
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
  for (const std::string& name : options_.touched_classes) {
    touched_.push_back(canonical_class_name(name));
  }
}

bool MaskPolicy::in_list(const Instance& instance, const std::vector<std::string>& class_names,
                         const std::vector<std::string>& list) const {
  if (!(instance.score >= options_.min_score)) return false;
  const auto id = static_cast<std::size_t>(instance.class_id);
  if (instance.class_id < 0 || id >= class_names.size()) return false;
  return std::find(list.begin(), list.end(), canonical_class_name(class_names[id])) != list.end();
}

bool MaskPolicy::is_dynamic(const Instance& instance,
                            const std::vector<std::string>& class_names) const {
  if (every_class_) return instance.score >= options_.min_score;
  return in_list(instance, class_names, canonical_);
}

std::vector<std::size_t> MaskPolicy::dynamic_instances(
    const Segmentation& segmentation, const std::vector<std::string>& class_names) const {
  require_sound("MaskPolicy", segmentation, {segmentation.width, segmentation.height});
  const auto& instances = segmentation.instances;
  std::vector<std::size_t> chosen;
  std::vector<std::size_t> candidates;
  for (std::size_t i = 0; i < instances.size(); ++i) {
    if (is_dynamic(instances[i], class_names)) {
      chosen.push_back(i);
    } else if (in_list(instances[i], class_names, touched_)) {
      candidates.push_back(i);
    }
  }
  if (candidates.empty() || chosen.empty()) return chosen;
  cv::Mat reach(segmentation.height, segmentation.width, CV_8UC1, cv::Scalar(0));
  for (const std::size_t i : chosen) paint(instances[i], reach);
  dilate_mask(reach, options_.touch_px);
  for (const std::size_t i : candidates) {
    if (cv::countNonZero(reach(instances[i].box) & instances[i].mask) > 0) chosen.push_back(i);
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

void MaskPolicy::mask(const Segmentation& segmentation, const std::vector<std::string>& class_names,
                      cv::Mat& mask) const {
  const auto chosen = dynamic_instances(segmentation, class_names);
  mask.create(segmentation.height, segmentation.width, CV_8UC1);
  mask.setTo(0);
  for (const std::size_t i : chosen) paint(segmentation.instances[i], mask);
  if (!chosen.empty()) dilate_mask(mask, options_.dilation_px);
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
  // Beyond the disc's reach of what is set nothing changes.
  const cv::Rect set = cv::boundingRect(mask);
  if (set.empty()) return;
  const cv::Rect reach(set.x - radius, set.y - radius, set.width + 2 * radius,
                       set.height + 2 * radius);
  cv::Mat window = mask(reach & cv::Rect(cv::Point(), mask.size()));
  // OpenCV's filter costs the area of the disc: faster for small ones.
  if (radius <= 6) {
    dilate_by_filter(window, radius);
  } else {
    dilate_by_columns(window, radius);
  }
}

int dilation_at_level(double patch_radius, double scale, int level) {
  require(patch_radius >= 0.0, "dilation_at_level", "patch_radius", patch_radius, "at least 0");
  require(scale >= 1.0, "dilation_at_level", "scale", scale, "at least 1");
  require(level >= 0, "dilation_at_level", "level", level, "at least 0");
  return static_cast<int>(std::min(std::ceil(patch_radius * std::pow(scale, level)), 100.0));
}

std::vector<cv::Mat> masks_by_level(const cv::Mat& mask, double patch_radius, double scale,
                                    int levels) {
  require(!mask.empty() && mask.dims == 2 && mask.type() == CV_8UC1, "masks_by_level", "mask",
          mask.empty() ? "an empty image" : cv::typeToString(mask.type()),
          "CV_8UC1 in two dimensions");
  require(levels >= 1, "masks_by_level", "levels", levels, "at least 1");
  std::vector<cv::Mat> masks;
  for (int level = 0; level < levels; ++level) {
    cv::Mat wide = mask.clone();
    dilate_mask(wide, dilation_at_level(patch_radius, scale, level));
    const double shrink = std::pow(scale, level);
    const cv::Size size(std::max(static_cast<int>(std::lround(mask.cols / shrink)), 1),
                        std::max(static_cast<int>(std::lround(mask.rows / shrink)), 1));
    cv::Mat small;
    cv::resize(wide, small, size, 0, 0, cv::INTER_NEAREST);
    masks.push_back(small);
  }
  return masks;
}

}  // namespace dynslam::segmentation
