// The common start of all measures: check, associate, align.
#pragma once

#include <string_view>
#include <vector>

#include "dynslam/evaluation/metrics.hpp"

namespace dynslam::evaluation {

/// Two trajectories made comparable.
struct Associated {
  std::vector<PosePair> pairs;
  AlignmentResult alignment;
  Trajectory aligned;  ///< the whole estimate in the truth's frame
  Coverage coverage;
};

/// Checks both trajectories (InvalidArgument in the name of `function`), associates and aligns.
Associated make_associated(std::string_view function, Span<const StampedPose> truth,
                           Span<const StampedPose> estimate, const AssociationOptions& association,
                           Alignment alignment);

/// Path length from the first of the associated poses to each, on one of the trajectories.
std::vector<double> path_lengths(Span<const StampedPose> trajectory,
                                 const std::vector<PosePair>& pairs, std::size_t PosePair::*side);

/// (Q_i^-1 Q_j)^-1 (P_i^-1 P_j), the error of the motion from pair `first` to pair `second`.
RigidTransform relative_error(Span<const StampedPose> truth, Span<const StampedPose> estimate,
                              const PosePair& first, const PosePair& second);

/// Angle of a rotation, degrees.
double angle_deg(const Eigen::Matrix3d& R);

}  // namespace dynslam::evaluation
