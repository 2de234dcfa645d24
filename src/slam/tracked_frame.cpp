#include "tracked_frame.hpp"

namespace dynslam::slam {

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
