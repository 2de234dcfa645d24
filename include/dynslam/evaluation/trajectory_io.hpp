// Trajectories in files: TUM and KITTI text.
#pragma once

#include <string>
#include <string_view>

#include "dynslam/core/span.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::evaluation {

/// How a trajectory is written down.
enum class TrajectoryFormat {
  kAuto,   ///< told from the first row: 8 numbers are TUM, 12 are KITTI (reading only)
  kTum,    ///< `time tx ty tz qx qy qz qw`: seconds, metres, unit quaternion, camera to world
  kKitti,  ///< the 3x4 matrix camera to world by rows, 12 numbers, one row a frame
};

/// How `read_trajectory` reads.
struct ReadTrajectoryOptions {
  TrajectoryFormat format = TrajectoryFormat::kAuto;
  /// KITTI only: file of one timestamp (seconds) a row, as many as poses. Empty: frame i has the
  /// timestamp i.
  std::string times_path;
  /// Accept timestamps out of order and sort them; equal ones stay an error. Engineering.
  bool sort = false;
  /// Of poses with equal timestamps keep the first instead of refusing the file. Motion capture
  /// files rounded to 1e-4 s have such rows (TUM fr2_desk has one). Engineering.
  bool drop_repeated = false;
  /// Largest | |q| - 1 | of a TUM quaternion and largest entry of | R^T R - I | of a KITTI rotation
  /// that is taken for rounding and normalized away, in [0, 0.5]. Engineering: files with four
  /// decimals deviate by 1e-4.
  double rotation_tolerance = 1e-2;

  /// Throws InvalidArgument naming the member that breaks its rule (also `times_path` together with
  /// TUM).
  void validate() const;
};

/// Reads a trajectory from a file.
///
/// Columns are separated by blanks, tabs or commas; `#` starts a comment; blank lines and carriage
/// returns are skipped. Numbers are read with '.' as the decimal point whatever the locale is. The
/// poses' rotations come back normalized, the timestamps strictly increasing.
///
/// Throws IoError "path:line: what, expected ..." for a file that cannot be opened, that holds no
/// pose, a row with another count of numbers, a number that is not one, NaN or infinity, a zero or
/// non-unit quaternion, a matrix that is no rotation, a repeated timestamp, a timestamp that runs
/// backwards (naming both lines), or another count of times than of poses; InvalidArgument for
/// broken options. O(bytes); reads the file into memory. Thread-safe.
Trajectory read_trajectory(const std::string& path, const ReadTrajectoryOptions& options = {});

/// The same for text in memory; `name` stands for the path in messages. `options.times_path` is
/// still a file.
Trajectory parse_trajectory(std::string_view text, const std::string& name,
                            const ReadTrajectoryOptions& options = {});

/// Writes a trajectory, TUM or KITTI (kAuto is InvalidArgument).
///
/// TUM begins with one comment that names the columns, timestamps have the fewest digits that read
/// back to the same double, all else nine decimals, quaternions w >= 0. KITTI has no timestamps;
/// see `write_times`. The file appears complete or not at all: it is written beside `path` under
/// another name and renamed; an older file stays as it was if that fails.
///
/// Throws InvalidArgument when a pose or timestamp is not finite, IoError when the folder cannot be
/// written or the disk is full. O(poses). Thread-safe for different paths.
void write_trajectory(const std::string& path, Span<const StampedPose> trajectory,
                      TrajectoryFormat format = TrajectoryFormat::kTum);

/// Writes the timestamps alone, one a row, as KITTI's times.txt. Otherwise as `write_trajectory`.
void write_times(const std::string& path, Span<const StampedPose> trajectory);

}  // namespace dynslam::evaluation
