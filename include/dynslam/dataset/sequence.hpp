// Sequences of frames: what every reader of this room and the rendered scene give, and what a SLAM
// system consumes.
#pragma once

#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <string>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/trajectory.hpp"

namespace dynslam::dataset {

/// What a frame holds besides its image.
enum class SensorKind {
  kMono,    ///< one image
  kRgbd,    ///< image and a depth image registered to it
  kStereo,  ///< rectified left and right image; `camera().bf` is fx times the measured baseline
};

/// "mono", "rgbd" or "stereo".
const char* to_string(SensorKind sensor);

/// One moment of a sequence. The images are this frame's own: whoever holds the frame may write to
/// them, no reader keeps a reference.
struct Frame {
  std::size_t index = 0;   ///< place in the sequence, from 0
  double timestamp = 0.0;  ///< seconds, strictly increasing over a sequence
  std::string name;        ///< stem of the image file, for example "1000.066667"
  cv::Mat color;  ///< left image, CV_8UC3 (BGR) or CV_8UC1; without distortion; never empty
  cv::Mat depth;  ///< CV_32FC1, metres along the optical axis, 0 = none; empty unless kRgbd
  cv::Mat right;  ///< rectified right image, type of `color`; empty unless kStereo
  cv::Mat mask;   ///< true labels, CV_8UC1, 0 = static, other values as in the file
                  ///< (not only 255); empty if the sequence has none for this frame
  std::optional<RigidTransform> T_world_cam;  ///< true pose at `timestamp` if it is known
};

/// What a reader left out while it opened a sequence. All zero for a sequence in good order.
struct OpenReport {
  std::size_t disordered_frames = 0;  ///< frames whose time did not increase (`skip_disordered`)
  std::size_t disordered_truth = 0;   ///< truth rows whose time did not increase (same)
  std::size_t unmatched_frames = 0;   ///< colour images without a depth image near in time
  std::string first_disordered;       ///< "path:line: what" of the first of the disordered rows
};

/// A recorded or rendered sequence. All images have the camera's width and height.
///
/// Thread-safety: const members may be called from several threads at once.
class Sequence {
 public:
  Sequence() = default;
  virtual ~Sequence();
  Sequence(const Sequence&) = delete;
  Sequence& operator=(const Sequence&) = delete;

  /// Name for reports: the folder's or the scene's.
  virtual std::string name() const = 0;
  /// Number of frames, at least 1.
  virtual std::size_t size() const = 0;
  /// Seconds, strictly increasing in `index`. Throws InvalidArgument if index >= size().
  virtual double timestamp(std::size_t index) const = 0;
  /// `Frame::name` without reading the frame. Throws InvalidArgument if index >= size().
  virtual std::string frame_name(std::size_t index) const = 0;
  /// Reads or renders a frame. Allocates its images. Throws InvalidArgument if index >= size();
  /// IoError naming the file if an image is missing, cut short, or of the wrong size or type. A bad
  /// frame does not hurt the others: the caller may go on with the next index.
  virtual Frame read(std::size_t index) const = 0;
  /// Camera of `Frame::color` as `read` returns it. Valid (`camera().validate()` passes); bf is
  /// measured for kStereo, virtual for kRgbd, of no meaning for kMono.
  virtual DepthCamera camera() const = 0;
  virtual SensorKind sensor() const = 0;
  /// Nominal frames a second, > 0.
  virtual double fps() const = 0;
  /// True camera poses at the times of the truth, which need not be those of the frames; empty if
  /// there is no truth. Lives as long as the sequence.
  virtual const Trajectory& truth() const = 0;
  /// What was left out while opening. Default: nothing.
  virtual OpenReport report() const;
};

/// Pose at time t along the screw between the two neighbours in `truth`, which must be in
/// increasing order of time.
///
/// A pose with exactly that time (to 1 microsecond) is returned as it is. Otherwise nothing if t
/// is NaN, before the first pose, after the last, or between two poses more than `max_gap` seconds
/// apart. O(log n), no allocation.
std::optional<RigidTransform> pose_at(const Trajectory& truth, double t, double max_gap = 0.2);

/// Frames [first, last) of a sequence as a sequence of its own, with indices from 0, the same names
/// and times and the whole truth. `last` past the end means the end. Throws InvalidArgument if
/// `sequence` is null or first >= min(last, size()).
std::unique_ptr<Sequence> slice(std::unique_ptr<Sequence> sequence, std::size_t first,
                                std::size_t last = std::numeric_limits<std::size_t>::max());

}  // namespace dynslam::dataset
