// The one sequence behind all readers: a list of files, and what is done to images on reading.
// Internal.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/dataset/parsing.hpp"
#include "dynslam/dataset/sequence.hpp"

namespace dynslam::dataset::detail {

/// Takes images of one camera to those of a pinhole: removes distortion and turns the camera.
/// Empty: leaves images as they are.
class Undistorter {
 public:
  Undistorter() = default;
  /// From `camera` with `distortion` to the pinhole K (3x3), turned by R (3x3) if not empty. Throws
  /// IoError naming `path` if OpenCV refuses the calibration.
  Undistorter(const PinholeCamera& camera, const Distortion& distortion, const cv::Mat& R,
              const cv::Mat& K, const std::string& path);

  bool empty() const { return map_.empty(); }
  cv::Mat smooth(const cv::Mat& image) const;   ///< bilinear, for pictures
  cv::Mat nearest(const cv::Mat& image) const;  ///< for depth and labels; 0 where nothing was seen

 private:
  cv::Mat map_, fraction_, nearest_map_;
};

/// Where a frame's images are; empty paths for what it does not have.
struct FrameFiles {
  double timestamp = 0.0;
  std::string name;
  std::filesystem::path color, depth, right, mask;
  std::optional<RigidTransform> T_world_cam;
};

struct FileSequenceData {
  std::string name;
  SensorKind sensor = SensorKind::kMono;
  DepthCamera camera;  ///< width and height 0: as the images are
  double fps = 0.0;    ///< 0: from the times
  double depth_scale = 5000.0;
  Undistorter undistorter, right_undistorter;
  std::vector<FrameFiles> frames;
  Trajectory truth;
  OpenReport report;
};

/// Completes and checks the data: size of the images if the camera does not say, frames a second.
/// Throws IoError naming `folder` if there are no frames or the camera is not valid.
std::unique_ptr<Sequence> make_file_sequence(FileSequenceData data,
                                             const std::filesystem::path& folder);

/// Gives every frame its pose from `data->truth` by `pose_at`.
void add_poses(double max_gap, FileSequenceData* data);

/// Adds mask/<name>.png where it exists.
void add_masks(const std::filesystem::path& folder, FileSequenceData* data);

/// Poses in order of time. A time that does not increase throws IoError "path:line: ...", or with
/// `skip` is left out and counted.
Trajectory ordered_truth(const std::vector<PoseRow>& rows, const std::string& path, bool skip,
                         OpenReport* report);

/// The same for rows of frames; `line_of(row)` and `time_of(row)` tell place and time.
class OrderCheck {
 public:
  OrderCheck(std::string path, bool skip, std::size_t* count, OpenReport* report)
      : path_(std::move(path)), skip_(skip), count_(count), report_(report) {}
  /// True if the time increases; else throws, or counts and returns false.
  bool accept(double timestamp, std::size_t line);

 private:
  std::string path_;
  bool skip_;
  std::size_t* count_;
  OpenReport* report_;
  std::optional<double> last_;
};

}  // namespace dynslam::dataset::detail
