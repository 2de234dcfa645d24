#include "tracked_frame.hpp"

#include <utility>

namespace dynslam::slam {

void TrackedFrame::add_sought(FrameFeaturesPtr with_sought) {
  if (corners == nullptr) corners = features;
  features = std::move(with_sought);
  resize_to_features();
}

void TrackedFrame::drop_sought() {
  if (corners == nullptr) return;
  features = std::exchange(corners, nullptr);
  resize_to_features();
}

void TrackedFrame::resize_to_features() {
  const std::size_t size = features->size();
  points.resize(size, kNoId);
  rejected.resize(size, 0);
  previous.resize(size, -1);
  moving.resize(size, 0);
  staticness.resize(size, std::numeric_limits<float>::quiet_NaN());
}

bool ensure_surface(const PinholeCamera& camera, TrackedFrame& frame) {
  if (frame.depth.empty()) return false;
  if (frame.surface.empty()) {
    build_surface_grid(frame.depth, frame.gray_cells, camera, frame.surface);
  }
  return true;
}

FeaturesView view_of(const TrackedFrame& frame) {
  FeaturesView view;
  if (!frame.features) return view;
  view.features = frame.features;
  view.verdicts.assign(frame.features->size(), FeatureVerdict::kUnmatched);
  for (std::size_t i = 0; i < view.verdicts.size(); ++i) {
    if (frame.moving[i] != 0) {
      view.verdicts[i] = FeatureVerdict::kMoving;
    } else if (frame.rejected[i] != 0) {
      view.verdicts[i] = FeatureVerdict::kRejected;
    } else if (frame.points[i] != kNoId) {
      view.verdicts[i] = FeatureVerdict::kStatic;
    }
  }
  return view;
}

}  // namespace dynslam::slam
