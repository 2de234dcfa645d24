#include "loop_correction.hpp"

#include <algorithm>

#include "median_depth.hpp"

namespace dynslam::slam {
namespace {

using factors::Similarity;

constexpr int kManyShared = 100;         // points that make an edge beside the spanning tree
constexpr double kLeastParallax = 0.01;  // between keyframes from one place, so that scale is bound

// Of a keyframe's points; 1 m if it has none.
double depth_of(const Map& map, const Keyframe& keyframe) {
  return std::max(median_depth(map, keyframe.points, keyframe.T_cam_world).value_or(1.0), 1e-3);
}

}  // namespace

void EssentialGraph::add_edge(std::uint32_t from, std::uint32_t to, const Similarity& S_to_from,
                              int points, double scale_share) {
  factors::Sim3GraphEdge edge;
  edge.from = from;
  edge.to = to;
  edge.S_to_from = S_to_from;
  edge.information.topLeftCorner<3, 3>() /= depth_ * depth_;
  edge.information(6, 6) = scale_share;
  edge.information *= std::max(points, 1);
  edges_.push_back(edge);
}

void EssentialGraph::add_present(std::uint32_t from, std::uint32_t to, int points) {
  const RigidTransform T_to_from = before_[to] * before_[from].inverse();
  const double parallax = std::max(T_to_from.t.norm() / depth_, kLeastParallax);
  add_edge(from, to, Similarity(T_to_from), points, parallax * parallax);
}

void EssentialGraph::collect(const Map& map, const std::vector<LoopMatch>& loops) {
  keyframes_ = map.keyframe_ids();
  for (const KeyframeId id : keyframes_) {
    index_.emplace(id, static_cast<std::uint32_t>(index_.size()));
    before_.push_back(map.keyframe(id).T_cam_world);
  }
  depth_ = depth_of(map, map.keyframe(keyframes_.back()));
  for (std::uint32_t to = 1; to < keyframes_.size(); ++to) {
    // Neighbours come with the most shared points first: the first older one is the parent.
    bool parent = false;
    const auto& covisible = map.keyframe(keyframes_[to]).covisible;
    for (const KeyframeId id : map.covisible_keyframes(keyframes_[to], covisible.size())) {
      const std::uint32_t from = index_.at(id);
      if (from > to) continue;
      const int shared = covisible.at(id);
      if (parent && shared < kManyShared) break;
      add_present(from, to, shared);
      parent = true;
    }
    if (!parent) add_present(to - 1, to, 1);
  }
  for (const LoopMatch& loop : loops) add_loop(loop);
}

bool EssentialGraph::add_loop(const LoopMatch& loop) {
  const auto from = index_.find(loop.match), to = index_.find(loop.query);
  if (from == index_.end() || to == index_.end()) return false;
  add_edge(from->second, to->second, loop.S_query_match, loop.inliers, 1.0);
  return true;
}

bool EssentialGraph::solve() {
  if (!with_scale_) return solve_rigid();
  after_ = std::vector<Similarity>(before_.begin(), before_.end());
  return factors::usable(factors::optimize_pose_graph(after_, edges_).status);
}

bool EssentialGraph::solve_rigid() {
  std::vector<factors::PoseGraphEdge> edges;
  for (const factors::Sim3GraphEdge& edge : edges_) {
    edges.push_back(
        {edge.from, edge.to, edge.S_to_from.rigid(), edge.information.topLeftCorner<6, 6>()});
  }
  std::vector<RigidTransform> poses = before_;
  if (!factors::usable(factors::optimize_pose_graph(poses, edges).status)) return false;
  after_ = std::vector<Similarity>(poses.begin(), poses.end());
  return true;
}

MapCorrection EssentialGraph::correction() const {
  MapCorrection correction;
  for (std::size_t i = 0; i < keyframes_.size(); ++i) {
    correction.add(keyframes_[i], before_[i], after_[i]);
  }
  return correction;
}

}  // namespace dynslam::slam
