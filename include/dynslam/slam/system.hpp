// RGB-D SLAM composed from the rooms below.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/trajectory.hpp"
#include "dynslam/loop/vocabulary.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/loop_closure.hpp"
#include "dynslam/slam/map.hpp"
#include "dynslam/slam/map_io.hpp"
#include "dynslam/slam/options.hpp"

namespace dynslam::slam {

/// What became of a frame.
enum class TrackingState {
  kNotInitialized,  ///< no map yet: the frame had too few features with depth
  kTracked,         ///< pose from the last frame and the map
  kRelocalized,     ///< found again by its look alone, farther off than a camera can move, or the
                    ///< first of a new map that begins where the camera was seen last
  kLost,            ///< no pose
};

/// "tracked" etc.
const char* to_string(TrackingState state);

/// Milliseconds spent on a frame, by stage.
struct StageTimes {
  double extract = 0.0;   ///< features
  double match = 0.0;     ///< prediction, windowed matching, recovery
  double geometry = 0.0;  ///< what moves, by depth
  double optimize = 0.0;  ///< pose
  double map = 0.0;       ///< making a keyframe
  double total = 0.0;     ///< the whole call
};

/// Milliseconds of work on keyframes; no frame waits for it with Threading::kBackground.
struct BackgroundTimes {
  double map = 0.0;   ///< local mapping: culling, fusion, local bundle adjustment
  double loop = 0.0;  ///< loops: detection, correction, global bundle adjustment
};

/// Result of System::track.
struct FrameResult {
  std::size_t index = 0;  ///< running number of the frame, 0-based
  double timestamp = 0.0;
  TrackingState state = TrackingState::kNotInitialized;
  std::optional<RigidTransform> T_world_cam;  ///< present unless lost or not initialized
  int features = 0;                           ///< found outside the mask
  /// Points of the map that agree with the pose. More than features where points were found by
  /// their looks that have no corner in this image.
  int inliers = 0;
  float masked_share = 0.0;    ///< of the image, 0..1
  int moving_features = 0;     ///< let go because geometry says that they move
  float moving_share = 0.0F;   ///< of the image, by geometry, 0..1
  bool keyframe = false;       ///< the frame became a keyframe
  std::size_t loops = 0;       ///< closed so far
  bool depth_aligned = false;  ///< too few features: the pose rests on the depth image as well
  StageTimes ms;
  BackgroundTimes background;  ///< finished since the last frame, on whichever thread
};

/// What the frame's mask and geometry together say about the image of a frame.
struct MoversView {
  /// CV_8UC1, 255 where something moves: what is under the mask, fitted to the depth image, what
  /// moves by geometry, and what likely belongs to either (behind something else, along contours):
  /// more than tracking lets go of. Empty without SystemOptions::geometry.
  cv::Mat mask;
  cv::Mat judged;  ///< CV_8UC1, 255 where there is a verdict, 0 where nothing is known; likewise
};

/// What became of a feature of a frame.
enum class FeatureVerdict : std::uint8_t {
  kUnmatched,  ///< shows no point of the map
  kStatic,     ///< shows a point of the map that stands still
  kRejected,   ///< its match disagrees with the pose
  kMoving,     ///< geometry says that it moves
};

/// The features of a frame, for drawing. None of them lies on the mask: nothing is extracted there.
struct FeaturesView {
  FrameFeaturesPtr features;             ///< null before the first frame
  std::vector<FeatureVerdict> verdicts;  ///< one a feature
};

/// Tracks an RGB-D camera in the map that it builds on the way.
///
/// Poses are camera to world; the world is the camera frame of the first frame that had a map.
///
/// Sequential (the default), the same input and options give the same output bit for bit. With
/// Threading::kBackground keyframes are worked on by threads of the system's own beside tracking;
/// the destructor ends them at the next opportunity, whatever they do. The functions here are
/// called by one thread at a time either way.
class System {
 public:
  /// Throws InvalidArgument if the camera or an option is invalid, or if the vocabulary is not one
  /// of descriptors of 32 bytes. An empty one: the system trains its own on the way.
  explicit System(const DepthCamera& camera, const SystemOptions& options = {},
                  loop::Vocabulary vocabulary = {});
  ~System();
  System(System&&) noexcept;
  System& operator=(System&&) noexcept;

  /// Takes the next frame. Throws InvalidArgument, changing nothing, if the image is empty or of
  /// another size or type than stated in FrameInput, if depth or mask do not fit it, or if the
  /// timestamp is not finite or not after the last one. A frame that cannot be tracked is a result,
  /// not an error. Throws what a background worker threw, if one did.
  FrameResult track(const FrameInput& frame);

  /// Waits until the background workers have done all that was asked for; throws what one threw.
  /// Nothing to wait for when sequential. Tracking may go on afterwards.
  void finish();

  /// Poses of all frames that have one, corrected by everything learned since. O(frames). With
  /// background workers: of this moment; call `finish` for the last word.
  Trajectory trajectory() const;
  /// Poses of the keyframes made since the start, not of those that `start_from` brought.
  Trajectory keyframe_trajectory() const;

  /// Loops closed so far, with background workers those of this moment.
  std::vector<LoopClosure> loops() const;

  /// What became of the features of the last frame. O(features), allocates.
  FeaturesView features() const;

  /// What moved in the last frame; shares memory with the system until the next `track`. 2 ms.
  MoversView movers() const;

  /// Goes on with a map made before, and with its world. Until a frame is recognized by its looks
  /// the camera is lost in it: the state is kLost, not kNotInitialized. Without a vocabulary one is
  /// trained on the map.
  ///
  /// Throws InvalidArgument, changing nothing, after the first frame, for a map without keyframes,
  /// and for one of another camera (bf may differ) or other pyramid levels.
  void start_from(StoredMap stored);
  /// Writes the map of this moment for `load_map`. Throws as slam::save_map.
  void save_map(const std::string& path) const;

  /// With background workers: between `finish` and the next `track` only, since they change it.
  const Map& map() const;
  const SystemOptions& options() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dynslam::slam
