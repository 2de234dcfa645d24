// Any bytes through the parsers of sequence folders: the first says which, the rest is the file.
#pragma once

#include <cmath>
#include <cstdlib>
#include <string_view>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

#include "dataset/image_file.hpp"

namespace dynslam::dataset::testing {

inline void must(bool holds) {
  if (!holds) std::abort();
}

/// Throws IoError for what the parsers refuse; aborts if they let something unsound pass.
inline void parse_any(std::string_view bytes) {
  if (bytes.empty()) return;
  const std::string_view text = bytes.substr(1), path = "fuzz";
  const auto check_images = [](const std::vector<ImageRow>& rows) {
    for (const ImageRow& row : rows) must(std::isfinite(row.timestamp) && row.line > 0);
  };
  const auto check_poses = [](const std::vector<PoseRow>& rows) {
    for (const PoseRow& row : rows) must(row.pose.T_world_cam.all_finite() && row.line > 0);
  };
  const auto check_camera = [](DepthCamera camera) {
    if (camera.width == 0) camera.width = 1;  // the file need not say
    if (camera.height == 0) camera.height = 1;
    camera.validate();
  };
  switch (bytes.front()) {
    case 'i':
      return check_images(parse_tum_images(text, path));
    case 'a':
      for (const AssociationRow& row : parse_tum_associations(text, path)) {
        check_images({row.color, row.depth});
      }
      return;
    case 'p':
      return check_poses(parse_tum_poses(text, path));
    case 'c':
      return check_camera(parse_camera(text, path).camera);
    case 'K':
      parse_kitti_calibration(text, path);
      return;
    case 't':
      for (const auto& [time, line] : parse_kitti_times(text, path)) must(std::isfinite(time));
      return;
    case 'P':
      for (const RigidTransform& T : parse_kitti_poses(text, path)) must(T.all_finite());
      return;
    case 'e':
      return check_images(parse_euroc_images(text, path));
    case 'g':
      return check_poses(parse_euroc_poses(text, path));
    case 's': {
      const EurocCamera camera = parse_euroc_camera(text, path);
      must(camera.T_body_cam.all_finite());
      return check_camera(camera.file.camera);
    }
    default:
      detail::find_damage(text);
  }
}

}  // namespace dynslam::dataset::testing
