#include "dynslam/segmentation/carried_region.hpp"

#include <algorithm>
#include <cmath>

#include "dynslam/core/errors.hpp"

#include "segmentation/carried_surfaces.hpp"
#include "segmentation/depth_window.hpp"
#include "segmentation/mask_carrier.hpp"

namespace dynslam::segmentation {

void CarriedRegionOptions::validate() const {
  const auto positive = [](double value, const char* name) {
    require(std::isfinite(value) && value > 0.0, "CarriedRegionOptions", name, value,
            "a positive number");
  };
  positive(arm_m, "arm_m");
  require(std::isfinite(behind_m) && behind_m >= 0.0, "CarriedRegionOptions", "behind_m", behind_m,
          "a number of at least 0");
  positive(max_share, "max_share");
  require(min_contact >= 0.0 && min_contact <= 1.0, "CarriedRegionOptions", "min_contact",
          min_contact, "a number from 0 to 1");
  depth.validate();
}

namespace {

constexpr std::size_t kMinCells = 12;  // of a thing; less is noise of the depth image's borders

// The surroundings of one carrier, in half-resolution cells.
class Reach {
 public:
  Reach(const HalfDepth& half, const CarriedRegionOptions& options, const CellMask& carrier,
        float carrier_depth)
      : half_(half), options_(options) {
    const double focal = options.depth.focal_ratio * half.width;
    const auto margin = static_cast<int>(std::ceil(options.arm_m * focal / carrier_depth));
    const cv::Rect& cells = carrier.cells;
    near_ = carrier_depth - static_cast<float>(options.arm_m);
    far_ = carrier_depth + static_cast<float>(options.behind_m);
    window_ = cv::Rect(cells.x - margin, cells.y - margin, cells.width + 2 * margin,
                       cells.height + 2 * margin) &
              cv::Rect(0, 0, half.width, half.height);
    most_ = options.max_share * cv::countNonZero(carrier.in);
    state_ = cv::Mat::zeros(half.height, half.width, CV_8UC1);
    state_(cells).setTo(kCarrier, carrier.in);
  }

  // Paints every carried thing's cells with 255.
  void paint(cv::Mat& cells) {
    for (int y = window_.y; y < window_.br().y; ++y) {
      for (int x = window_.x; x < window_.br().x; ++x) {
        if (!open({x, y}) || !touches({x, y})) continue;
        flood({x, y});
        if (!carried()) continue;
        for (const cv::Point cell : thing_) cells.at<std::uint8_t>(cell) = 255;
      }
    }
  }

 private:
  enum : std::uint8_t { kFree = 0, kCarrier = 1, kSeen = 2 };
  static constexpr int kSteps[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};

  bool open(cv::Point cell) const {
    const float z = half_.at(cell.x, cell.y);
    const auto index = static_cast<std::size_t>(cell.y) * static_cast<std::size_t>(half_.width) +
                       static_cast<std::size_t>(cell.x);
    return state_.at<std::uint8_t>(cell) == kFree && measured(z) && z >= near_ && z <= far_ &&
           half_.facing[index] != 0;
  }
  bool touches(cv::Point cell) const {
    return std::any_of(std::begin(kSteps), std::end(kSteps), [&](const int* step) {
      const cv::Point other = cell + cv::Point(step[0], step[1]);
      return window_.contains(other) && state_.at<std::uint8_t>(other) == kCarrier;
    });
  }
  bool one_surface(cv::Point a, cv::Point b) const {
    const float za = half_.at(a.x, a.y);
    const float zb = half_.at(b.x, b.y);
    return std::abs(za - zb) <= static_cast<float>(options_.depth.step_share) * std::min(za, zb) +
                                    static_cast<float>(options_.depth.step_m);
  }
  void flood(cv::Point start) {
    thing_.assign(1, start);
    outline_ = contact_ = 0;
    leaves_ = false;
    state_.at<std::uint8_t>(start) = kSeen;
    for (std::size_t next = 0; next < thing_.size(); ++next) {
      const cv::Point cell = thing_[next];
      for (const auto& step : kSteps) visit(cell, cell + cv::Point(step[0], step[1]));
    }
  }
  void visit(cv::Point cell, cv::Point other) {
    const cv::Rect image(0, 0, half_.width, half_.height);
    if (!window_.contains(other)) {
      leaves_ = leaves_ || image.contains(other);  // the image's own border says nothing
      return;
    }
    if (state_.at<std::uint8_t>(other) == kCarrier) {
      ++outline_;
      ++contact_;
    } else if (open(other) && one_surface(cell, other)) {
      state_.at<std::uint8_t>(other) = kSeen;
      thing_.push_back(other);
    } else if (state_.at<std::uint8_t>(other) == kFree) {
      ++outline_;
      // The surface goes on where nothing is carried any more: steep, or out of reach.
      leaves_ = leaves_ || (measured(half_.at(other.x, other.y)) && one_surface(cell, other));
    }
  }
  bool carried() const {
    return !leaves_ && thing_.size() >= kMinCells && static_cast<double>(thing_.size()) <= most_ &&
           contact_ >= options_.min_contact * outline_;
  }

  const HalfDepth& half_;
  const CarriedRegionOptions& options_;
  cv::Rect window_;
  float near_ = 0.0F, far_ = 0.0F;
  double most_ = 0.0;  // cells that a thing may have
  cv::Mat state_;
  std::vector<cv::Point> thing_;
  int outline_ = 0, contact_ = 0;
  bool leaves_ = false;
};

}  // namespace

cv::Mat carried_region(const Segmentation& segmentation, const std::vector<std::size_t>& carriers,
                       DepthView depth, const CarriedRegionOptions& options) {
  options.validate();
  cv::Mat region = cv::Mat::zeros(segmentation.height, segmentation.width, CV_8UC1);
  for (const std::size_t i : carriers) {
    require(i < segmentation.instances.size(), "carried_region", "carriers", i,
            "less than " + std::to_string(segmentation.instances.size()));
  }
  if (depth.empty() || carriers.empty()) return region;
  require(depth.width == segmentation.width && depth.height == segmentation.height,
          "carried_region", "depth",
          std::to_string(depth.width) + "x" + std::to_string(depth.height),
          "the segmentation's size " + std::to_string(segmentation.width) + "x" +
              std::to_string(segmentation.height));
  HalfDepth half;
  half.build(depth, options.depth);
  CellMask cells;
  cells.cells = cv::Rect(0, 0, half.width, half.height);
  cells.in = cv::Mat::zeros(half.height, half.width, CV_8UC1);
  for (const std::size_t i : carriers) {
    const CellMask carrier = cell_mask(segmentation.instances[i], &half);
    const float carrier_depth = median_depth(carrier);
    if (carrier_depth > 0.0F) Reach(half, options, carrier, carrier_depth).paint(cells.in);
  }
  Instance painted;
  paint_cells(cells, region.size(), painted);
  if (!painted.box.empty()) painted.mask.copyTo(region(painted.box));
  for (const std::size_t i : carriers) {
    const Instance& carrier = segmentation.instances[i];
    region(carrier.box).setTo(0, carrier.mask);
  }
  return region;
}

}  // namespace dynslam::segmentation
