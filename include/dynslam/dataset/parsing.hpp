// The text formats of the data sets, as pure functions from a file's content to plain structs.
//
// They open no files, keep no state and hold for hostile input: whatever the text, they return or
// throw IoError "path:line: what, expected ...". `path` only names the text in messages. Numbers
// are read the same in every locale; a number that is not finite is refused. Lines end in LF or
// CRLF; blank lines and lines that start with '#' mean nothing. Cost: O(length of the text).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::dataset {

/// A row of an image list.
struct ImageRow {
  double timestamp = 0.0;  ///< seconds
  std::string file;        ///< as written, relative to the folder
  std::size_t line = 0;    ///< from 1
};

/// A row of associations.txt.
struct AssociationRow {
  ImageRow color;
  ImageRow depth;
};

/// A row of a file of poses.
struct PoseRow {
  StampedPose pose;
  std::size_t line = 0;  ///< from 1
};

/// rgb.txt and depth.txt of TUM RGB-D: "time file".
std::vector<ImageRow> parse_tum_images(std::string_view text, std::string_view path);

/// associations.txt: "time colour-file time depth-file".
std::vector<AssociationRow> parse_tum_associations(std::string_view text, std::string_view path);

/// groundtruth.txt: "time tx ty tz qx qy qz qw", camera to world, metres. The quaternion is
/// normalized; one whose norm is not within 0.05 of 1 is refused.
std::vector<PoseRow> parse_tum_poses(std::string_view text, std::string_view path);

/// Radial-tangential lens distortion k1 k2 p1 p2 k3 (OpenCV's order), of normalized coordinates.
using Distortion = std::array<double, 5>;

/// A camera as the folder describes it.
struct CameraFile {
  DepthCamera camera;  ///< width and height 0 if the file does not say
  Distortion distortion{};
  std::optional<double> fps;          ///< frames a second
  std::optional<double> depth_scale;  ///< units of the depth image a metre
};

/// camera.txt: pairs of key and number over one or several lines. Needed: fx fy cx cy. Known
/// besides: width height fps depth_scale bf k1 k2 p1 p2 k3. A missing bf becomes a virtual baseline
/// of 40 / 525 m. Any other key, a key given twice, and a value that breaks `DepthCamera::validate`
/// are refused.
CameraFile parse_camera(std::string_view text, std::string_view path);

/// The published calibration of a TUM RGB-D or Bonn sequence that is recognised by its folder's
/// name
/// ("...freiburg1...", "...freiburg2...", "...freiburg3...", "rgbd_bonn_..."); 640 x 480, 30 Hz,
/// 5000 units a metre. Nothing for another name.
std::optional<CameraFile> known_tum_camera(std::string_view folder_name);

/// calib.txt of KITTI odometry: projection matrices P0..P3, 3 x 4. Lines are "P0: 12 numbers" in
/// any order or 12 bare numbers (then line k is P(k-1)); "Tr:" is ignored. P0 must be there.
struct KittiCalibration {
  std::array<std::optional<Eigen::Matrix<double, 3, 4>>, 4> P;
};
KittiCalibration parse_kitti_calibration(std::string_view text, std::string_view path);

/// times.txt of KITTI: one time in seconds a line.
std::vector<std::pair<double, std::size_t>> parse_kitti_times(std::string_view text,
                                                              std::string_view path);

/// poses.txt of KITTI: 12 numbers a line, the 3 x 4 camera-to-world matrix by rows. The left block
/// is projected onto the rotations; one farther than 1e-2 from a rotation is refused.
std::vector<RigidTransform> parse_kitti_poses(std::string_view text, std::string_view path);

/// camN/data.csv of EuRoC: "time in ns,file".
std::vector<ImageRow> parse_euroc_images(std::string_view text, std::string_view path);

/// state_groundtruth_estimate0/data.csv of EuRoC: "time in ns, px,py,pz, qw,qx,qy,qz, ...", body to
/// world; columns after the eighth are ignored.
std::vector<PoseRow> parse_euroc_poses(std::string_view text, std::string_view path);

/// camN/sensor.yaml of EuRoC. Only the radial-tangential pinhole is understood; another
/// `camera_model` or `distortion_model` is refused by name.
struct EurocCamera {
  CameraFile file;
  RigidTransform T_body_cam;  ///< T_BS
};
EurocCamera parse_euroc_camera(std::string_view text, std::string_view path);

/// Pairs of times of `a` and `b` (seconds, any order) that lie at most `max_difference` apart. Of
/// all admissible pairs the closest is taken first, then the closest of what is left, and so on
/// (the rule of the TUM benchmark's own tool, which compares with < instead of <=); among equally
/// close pairs the earliest. Every time is used once. Returns pairs (index in a, index in b) in
/// increasing order of the time in a.
///
/// O((n + m) log(n + m)) for n and m times, also where all of them are close to each other. A time
/// that is not finite is never paired. Throws InvalidArgument if max_difference is negative or NaN.
std::vector<std::pair<std::size_t, std::size_t>> associate(Span<const double> a,
                                                           Span<const double> b,
                                                           double max_difference);

/// Order in which people count: runs of digits compare as numbers, the rest byte by byte;
/// "2.png" < "10.png". A strict weak ordering. O(length).
bool natural_less(std::string_view a, std::string_view b);

}  // namespace dynslam::dataset
