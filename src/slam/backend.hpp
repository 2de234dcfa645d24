// What happens to a keyframe after it was made, at once or in the background.
#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <mutex>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/slam/options.hpp"
#include "dynslam/slam/system.hpp"

#include "local_mapper.hpp"
#include "loop_closer.hpp"
#include "shared_map.hpp"
#include "worker.hpp"

namespace dynslam::slam {

/// Local mapping, then loop closing, on the caller's thread or on workers of its own.
///
/// The stages are the same code either way; with Threading::kBackground keyframes wait for them in
/// bounded queues. Used by one thread.
class Backend {
 public:
  Backend(const DepthCamera& camera, const SystemOptions& options,
          const std::vector<float>& scale_factors, loop::Vocabulary vocabulary, SharedMap& shared);
  /// Ends the work at the next opportunity and joins the workers.
  ~Backend();

  /// Goes on with the map there is, before the first keyframe.
  void adopt_map();

  /// False while local mapping lags behind: no keyframe should be made then.
  bool accepts_keyframe() const;
  /// As LocalMapper::insert: the caller holds the map.
  KeyframeId insert(TrackedFrame& frame, std::size_t frame_index);
  /// See LocalMapper::insert_start. The caller holds the map.
  KeyframeId insert_start(const MonoStart& start, TrackedFrame& second, std::size_t frame_index);
  /// Has a keyframe refined, now or in the background. The caller must not hold the map.
  void process(KeyframeId keyframe);

  /// Waits for all work that was asked for and throws what a worker threw.
  void finish();
  /// Throws what a worker threw, if anything.
  void rethrow_failure() const;

  /// Milliseconds of work since the last call, on whichever thread.
  BackgroundTimes take_times();

  /// Keyframes that look most like a frame, best first; none while nothing is known of looks. Needs
  /// no lock.
  std::vector<KeyframeId> similar(const FrameFeatures& features, std::size_t count) const;
  /// Loops closed so far. The caller holds the map.
  const std::vector<LoopClosure>& closures() const;

 private:
  void refine(KeyframeId keyframe);
  void look_for_loop(KeyframeId keyframe);
  void add_time(double BackgroundTimes::*stage, double ms);

  LocalMapper mapper_;
  std::unique_ptr<LoopCloser> closer_;  // null: switched off
  std::atomic<bool> stop_{false};
  std::mutex times_mutex_;
  BackgroundTimes times_;
  // Null: everything happens at once. Mapping, which feeds the loops, ends first.
  std::unique_ptr<Worker> loops_, mapping_;
};

}  // namespace dynslam::slam
