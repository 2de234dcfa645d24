// The pose graph that closes a loop.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "dynslam/factors/pose_graph.hpp"
#include "dynslam/slam/map.hpp"

#include "loop_check.hpp"
#include "map_correction.hpp"

namespace dynslam::slam {

/// Keyframes and the motions between them: the essential graph.
///
/// Edges join each keyframe to the earlier one that it shares most points with (the spanning tree),
/// to all that it shares many with, and the two ends of every loop; their measurements are the
/// present relative poses, and for loops the motion that was verified. An edge of n points at depth
/// z weighs n for rotation and n / z^2 for translation, as n reprojections do. The scale, where it
/// is free, shows in their parallax over the baseline b, n b^2 / z^2; a loop compares the distances
/// of its points, n.
class EssentialGraph {
 public:
  /// `with_scale`: keyframes may grow and shrink, as those of maps without depth must.
  explicit EssentialGraph(bool with_scale) : with_scale_(with_scale) {}

  /// Copies keyframes and edges. `loops`: those closed before, still in the map or not.
  void collect(const Map& map, const std::vector<LoopMatch>& loops);
  /// Adds the loop to close. False if one of its keyframes is not there.
  bool add_loop(const LoopMatch& loop);

  /// Spreads the error over the graph; the oldest keyframe stays. False if nothing came of it.
  bool solve();
  MapCorrection correction() const;

 private:
  /// `scale_share`: what the scale weighs beside the rotation.
  void add_edge(std::uint32_t from, std::uint32_t to, const factors::Similarity& S_to_from,
                int points, double scale_share);
  /// What lies between the present poses of two keyframes that share points.
  void add_present(std::uint32_t from, std::uint32_t to, int points);
  bool solve_rigid();

  std::vector<KeyframeId> keyframes_;
  std::unordered_map<KeyframeId, std::uint32_t> index_;
  std::vector<RigidTransform> before_;
  std::vector<factors::Similarity> after_;
  double depth_ = 1.0;  // metres, usual distance of points
  std::vector<factors::Sim3GraphEdge> edges_;
  bool with_scale_;
};

}  // namespace dynslam::slam
