// One run of a system over a sequence.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "dynslam/core/trajectory.hpp"
#include "dynslam/dataset/sequence.hpp"
#include "dynslam/evaluation/report.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

namespace dynslam::cli {

/// What `dynslam run` was asked for.
struct RunFlags {
  std::string system = "p-static";
  std::string sensor;  ///< rgbd, stereo or mono; empty: what the sequence has
  std::string segmenter = "none";
  std::string backend = "opencv";
  std::vector<std::string> classes;  ///< empty: the policy's own
  double min_score = 0.3;
  int dilation_px = 10;
  int segment_every = 1;
  int features = 1000;
  int threads = 0;                    ///< of OpenCV; 0: its own choice
  std::string vocabulary;             ///< file of words for loops; empty: learnt on the way
  std::string solver = "eliminated";  ///< of the weights: fixed, joint or eliminated
  std::vector<std::string> without;   ///< names of the slam::Parts that are left out
  bool realtime = false;
  bool beside = false;  ///< segment on a thread of its own, at the pace of the camera
  bool sequential = false;
  std::string video;           ///< file for what the system sees; empty: none
  bool show = false;           ///< the same in a window
  std::string load;            ///< map to start from; empty: none
  bool localize_only = false;  ///< leave the loaded map as it is

  /// Whether segmentation runs beside tracking: always in real time, unless one thread is asked
  /// for.
  bool asynchronous() const { return (realtime || beside) && !sequential; }
};

/// --solver, --vocabulary, --features, --threads, --realtime, --async, --sequential.
void add_tracking_flags(CLI::App& command, RunFlags& flags);

/// What became of a frame of a run.
enum class RowState : std::uint8_t {
  kNotInitialized,
  kTracked,
  kRelocalized,
  kLost,
  kUnreadable,
  kDropped,  ///< came while the one before was still at work
};

/// As frames.csv has it: "not_initialized", "tracked", "relocalized", "lost", "unreadable" or
/// "dropped".
const char* to_string(RowState state);

/// Milliseconds of a frame's stages.
struct StageRow {
  float extract = 0.0F, match = 0.0F, segment = 0.0F, geometry = 0.0F, optimize = 0.0F;
  float map = 0.0F;  ///< the tracking thread's and the workers'
  float loop = 0.0F;
  float total = 0.0F;  ///< of tracking, segmentation included where tracking waits for it
};

/// One frame of a run, a row of frames.csv. Small, because a run keeps one for each frame.
struct FrameRow {
  double timestamp = 0.0;
  std::uint32_t index = 0;
  std::int32_t features = 0;
  std::int32_t inliers = 0;
  std::uint32_t loops = 0;             ///< closed so far
  std::int32_t moving_features = 0;    ///< let go by geometry
  std::int32_t rejected_features = 0;  ///< whose match disagreed with the pose
  float moving_share = 0.0F;           ///< of the image, by geometry
  float masked_share = 0.0F;
  std::int32_t mask_age = 0;  ///< frames since the image that the mask was made from; -1: no mask
  StageRow ms;
  RowState state = RowState::kLost;
  bool keyframe = false;

  /// Whether the system was given the frame.
  bool processed() const { return state != RowState::kDropped && state != RowState::kUnreadable; }
  bool has_pose() const { return state == RowState::kTracked || state == RowState::kRelocalized; }
};

/// Frames at which the segmenter failed, and one of its reasons.
struct SegmenterFailures {
  std::size_t count = 0;
  std::string message;
};

/// What a run gave.
struct RunOutcome {
  std::vector<FrameRow> rows;
  std::vector<std::string> problems;  ///< of unreadable frames, first few
  SegmenterFailures unsegmented;
  Trajectory trajectory;
  std::unique_ptr<slam::System> system;
  double seconds = 0.0;
  std::vector<double> memory_mb;  ///< resident after each quarter of the frames

  std::size_t count(RowState state) const;
  /// Frames given to the system up to the first with a pose, that included; 0: none has one.
  std::size_t localized_after() const;
  std::size_t tracked() const { return count(RowState::kTracked) + count(RowState::kRelocalized); }
};

/// What the system is to use of the sequence's frames. Throws InvalidArgument when the flags ask
/// for what the sequence lacks.
slam::Sensor choose_sensor(const RunFlags& flags, const dataset::Sequence& sequence);

/// Throws InvalidArgument in the name of `command` for a sequence without depth images.
void require_depth(const char* command, const dataset::Sequence& sequence);

/// The system that the flags name, with their settings and without what they leave out.
slam::Composition composition_of(const RunFlags& flags);

/// Runs the system that the flags name. Throws InvalidArgument for a sequence without what the
/// sensor asked for needs and for unknown names; IoError if not a single frame could be read.
RunOutcome run_system(const dataset::Sequence& sequence, const RunFlags& flags);

}  // namespace dynslam::cli
