// From a new keyframe to a closed loop.
#pragma once

#include <atomic>
#include <cstddef>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/factors/bundle_adjustment.hpp"
#include "dynslam/slam/loop_closure.hpp"
#include "dynslam/slam/options.hpp"

#include "keyframe_database.hpp"
#include "loop_check.hpp"
#include "loop_correction.hpp"
#include "point_fusion.hpp"
#include "shared_map.hpp"

namespace dynslam::slam {

/// Keeps the database of keyframes and closes loops. `process` is the loop worker's alone; it holds
/// the map for a few milliseconds at a time.
class LoopCloser {
 public:
  LoopCloser(const DepthCamera& camera, const SystemOptions& options,
             const std::vector<float>& scale_factors, loop::Vocabulary vocabulary,
             SharedMap& shared);

  /// Looks whether a keyframe shows an old place again, and if so closes the loop; then stores it.
  /// A raised `stop` ends it early.
  void process(KeyframeId keyframe, const std::atomic<bool>& stop);

  /// Stores all keyframes of the map there is, which nobody works on yet.
  void adopt_map();

  /// For other threads: keyframes by their looks.
  const KeyframeDatabase& database() const { return database_; }
  /// Loops closed so far. The caller holds the map.
  const std::vector<LoopClosure>& closures() const { return closures_; }

 private:
  KeyframeLook look_of(const Map& map, KeyframeId id) const;
  std::vector<KeyframeId> never_left(const Map& map, KeyframeId query) const;
  void store_unseen(const Map& map, KeyframeId query);
  void forget_erased();
  bool train_if_due();
  void close(const LoopMatch& match, const std::atomic<bool>& stop);
  bool correct(const LoopMatch& match);
  void fuse(const LoopMatch& match, const std::atomic<bool>& stop);
  void adjust_all(const std::atomic<bool>& stop);

  DepthCamera camera_;
  LoopOptions options_;
  bool with_scale_;
  bool bundle_adjustment_;
  std::vector<float> scale_factors_;
  SharedMap& shared_;
  KeyframeDatabase database_;
  LoopCheck check_;
  PointFusion fusion_;
  factors::BundleWorkspace workspace_;
  std::vector<KeyframeId> stored_;     // in the database
  std::size_t next_training_;          // keyframes
  std::vector<LoopMatch> closed_;      // of keyframes that are in the map still, without points
  std::vector<LoopClosure> closures_;  // guarded by the map's lock
};

}  // namespace dynslam::slam
