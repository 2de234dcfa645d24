// All motions between two views that explain their matches, where several may.
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"

#include "two_view_motion.hpp"

namespace dynslam::slam {

/// Local optima of the epipolar errors over the rotation and the direction of translation, the
/// likeliest first, at most `most` of them; |t| = 1, of a sign that means nothing yet.
///
/// Over a small step, or before a plane, the errors have several valleys, and the few matches of a
/// random sample lead to any. Here each of a set of directions that cover the half sphere is
/// descended from by Gauss-Newton under Geman-McClure's loss, wide first (graduated non-convexity),
///   min sum rho(e^2 / sigma^2),  e = (R b_1) . (b_2 x t),
/// from the rotation `R_second_first`, which may be off by what parallax makes of a turn. Optima
/// of one valley (`same_valley`) are one. O(directions * matches), some milliseconds; allocates.
std::vector<RigidTransform> motion_valleys(const PinholeCamera& camera,
                                           const std::vector<PixelMatch>& matches,
                                           const Eigen::Matrix3d& R_second_first, std::size_t most);

/// Whether two motions are so near that they lie in one valley: 5 degrees in rotation and in
/// direction of translation.
bool same_valley(const RigidTransform& a, const RigidTransform& b);

}  // namespace dynslam::slam
