// How a surface stands, from a depth image.
#pragma once

#include <optional>

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/camera.hpp"

namespace dynslam::slam {

/// Unit normal, in camera coordinates and away from the camera, of the plane that a depth image
/// (CV_32FC1 metres, 0 or NaN = none) shows about a pixel. Nothing where six tenths of the square
/// within `radius` pixels are not one plane: edges, missing depth, borders of the image.
///
/// On a plane inverse depth is linear in the pixel, and its noise hardly depends on the distance.
/// Fitted to a grid of 9 x 9 pixels, in rounds with ever less tolerance. About 2 us; thread-safe.
std::optional<Eigen::Vector3d> surface_normal(const cv::Mat& depth, cv::Point2f pixel, float radius,
                                              const PinholeCamera& camera);

}  // namespace dynslam::slam
