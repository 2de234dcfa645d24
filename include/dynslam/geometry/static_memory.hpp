// Memory of what moved: log-odds over time per map point, and per cell of the last frame.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/verdict.hpp"

namespace dynslam::geometry {

struct StaticMemoryOptions {
  double half_life = 2.0;    ///< seconds until a remembered log-odds has halved, > 0: a parked car
                             ///< is forgiven; engineering
  double max_dynamic = 4.0;  ///< log-odds, > 0: most that is remembered against a point
  double max_static = 3.0;   ///< log-odds, > 0: most that is remembered in its favour: less, so
                             ///< that a chair that starts to move is found soon
  double decision = 0.6;     ///< |log-odds| below which a point is unknown, >= 0

  void validate() const;
};

/// Log-odds of each map point by its id, decaying over time.
///
///     l <- clamp(l 2^(-dt / half_life) + evidence, -max_static, max_dynamic)
///
/// Not thread-safe. O(1) an update; allocates when an id is new.
class StaticMemory {
 public:
  explicit StaticMemory(const StaticMemoryOptions& options = {});

  /// Adds this frame's evidence (log-odds; NaN counts as 0) at `time` seconds; returns the sum.
  /// Time that runs backwards does not decay.
  double update(std::uint64_t id, double evidence, double time);
  /// Adds the verdicts' log-odds for the ids (kNoId = not a map point: left as it is) and replaces
  /// verdict and log-odds by the remembered sum; reason becomes kRemembered where memory turns the
  /// verdict. Throws InvalidArgument for arrays of unequal size.
  void update(Span<const std::uint64_t> ids, double time, Span<FeatureVerdict> verdicts);
  /// Log-odds of a point at `time`, 0 if never heard of.
  double log_odds(std::uint64_t id, double time) const;
  Verdict verdict(std::uint64_t id, double time) const;
  /// Forgets a point that the map has removed.
  void erase(std::uint64_t id);
  /// Forgets points not updated since `time`.
  void erase_older_than(double time);
  void clear();
  std::size_t size() const;

  static constexpr std::uint64_t kNoId = ~std::uint64_t{0};

 private:
  struct Entry {
    float log_odds;
    double time;
  };
  double decayed(const Entry& entry, double time) const;

  StaticMemoryOptions options_;
  std::unordered_map<std::uint64_t, Entry> entries_;
};

struct CellMemoryOptions {
  double retention = 0.8;    ///< share of the log-odds that is handed on a frame, [0, 1)
  double max_dynamic = 4.0;  ///< log-odds, > 0
  double max_static = 2.0;   ///< log-odds, > 0
  double max_speed = 2.0;    ///< metres a second that a mover's surface may change depth and still
                             ///< be taken for the same, >= 0; engineering: walking people
  void validate() const;
};

/// Memory without ids: carries a frame's cell evidence to the next frame by reprojection.
///
/// A cell of the current frame inherits the log-odds of the previous frame's cell that projects
/// there at (nearly) the same depth, and adds its own. A mover that is caught once is so
/// remembered while it stands still or overlaps its own former image. Not thread-safe. No
/// allocation after warm-up.
class CellMemory {
 public:
  explicit CellMemory(const CellMemoryOptions& options = {});

  /// Adds what is remembered to `evidence` (log-odds, verdicts and counts change) and remembers the
  /// sum. `T_world_cam`: pose of this frame; `time` seconds. O(cells).
  void update(const PinholeCamera& camera, const RigidTransform& T_world_cam, double time,
              double decision, DepthEvidence& evidence);
  void clear();

 private:
  void carry(const PinholeCamera& camera, const RigidTransform& T_cur_last, double passed,
             const DepthEvidence& now);

  CellMemoryOptions options_;
  bool filled_ = false;
  double time_ = 0.0;
  RigidTransform T_world_cam_;
  DepthEvidence last_;
  std::vector<float> carried_;
};

}  // namespace dynslam::geometry

#include "dynslam/geometry/detail/static_memory_impl.hpp"
