#include "dynslam/segmentation/depth_refinement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

#include "segmentation/depth_window.hpp"

namespace dynslam::segmentation {

void DepthRefinementOptions::validate() const {
  const auto positive = [](double value, const char* name) {
    require(std::isfinite(value) && value > 0.0, "DepthRefinementOptions", name, value,
            "a positive number");
  };
  const auto not_negative = [](double value, const char* name) {
    require(std::isfinite(value) && value >= 0.0, "DepthRefinementOptions", name, value,
            "a number of at least 0");
  };
  const auto share = [](double value, const char* name) {
    require(value >= 0.0 && value <= 1.0, "DepthRefinementOptions", name, value,
            "a number from 0 to 1");
  };
  positive(focal_ratio, "focal_ratio");
  positive(step_share, "step_share");
  not_negative(step_m, "step_m");
  positive(max_slant, "max_slant");
  not_negative(max_growth, "max_growth");
  share(max_removal, "max_removal");
  share(side_margin, "side_margin");
  require(reach >= 0.0 && reach <= 10.0, "DepthRefinementOptions", "reach", reach, "0 to 10");
}

struct DepthRefiner::Impl {
  DepthRefinementOptions options;
  HalfDepth half;
  DepthWindow window;

  void refine(Instance& instance, DepthView depth);
  void from_box(Instance& instance, DepthView depth);
};

void DepthRefiner::Impl::refine(Instance& instance, DepthView depth) {
  if (!window.open(half, options, instance)) return;
  window.remove_what_does_not_belong();
  window.grow_beside_the_mask();
  window.add_parts_behind();
  window.fill_holes();
  window.write(depth, instance);
}

void DepthRefiner::Impl::from_box(Instance& instance, DepthView depth) {
  instance.mask = cv::Mat(instance.box.size(), CV_8UC1, cv::Scalar(255));
  if (!window.open_box(half, options, instance)) return;
  window.grow_beside_the_mask();
  window.add_parts_behind();
  window.fill_holes();
  window.write(depth, instance);
}

DepthRefiner::DepthRefiner(const DepthRefinementOptions& options)
    : impl_(std::make_unique<Impl>()) {
  options.validate();
  impl_->options = options;
}
DepthRefiner::~DepthRefiner() = default;
DepthRefiner::DepthRefiner(DepthRefiner&&) noexcept = default;
DepthRefiner& DepthRefiner::operator=(DepthRefiner&&) noexcept = default;

namespace {

void check(const char* function, const Segmentation& segmentation, DepthView depth) {
  require(depth.width == segmentation.width && depth.height == segmentation.height, function,
          "depth", std::to_string(depth.width) + "x" + std::to_string(depth.height),
          "the segmentation's size " + std::to_string(segmentation.width) + "x" +
              std::to_string(segmentation.height));
}

}  // namespace

void DepthRefiner::refine(Segmentation& segmentation, DepthView depth) {
  if (depth.empty() || segmentation.instances.empty()) return;
  check("DepthRefiner::refine", segmentation, depth);
  impl_->half.build(depth, impl_->options);
  for (Instance& instance : segmentation.instances) impl_->refine(instance, depth);
}

void DepthRefiner::masks_from_boxes(Segmentation& segmentation, DepthView depth) {
  if (depth.empty()) {
    for (Instance& instance : segmentation.instances) {
      instance.mask = cv::Mat(instance.box.size(), CV_8UC1, cv::Scalar(255));
    }
    return;
  }
  check("DepthRefiner::masks_from_boxes", segmentation, depth);
  impl_->half.build(depth, impl_->options);
  for (Instance& instance : segmentation.instances) impl_->from_box(instance, depth);
}

}  // namespace dynslam::segmentation
