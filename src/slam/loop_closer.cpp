#include "loop_closer.hpp"

#include <algorithm>
#include <iterator>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "dynslam/factors/bundle_adjustment.hpp"

#include "local_map.hpp"
#include "map_bundle.hpp"

namespace dynslam::slam {
namespace {

constexpr std::size_t kNeighbours = 20;     // of a keyframe, for consistency
constexpr std::size_t kFuseKeyframes = 10;  // around the query that take the old points over
constexpr std::size_t kTrainingGrowth = 2;  // a vocabulary serves maps up to so many times larger

loop::NeighboursOf neighbours_in(SharedMap& shared) {
  return [&shared](std::uint64_t id) {
    const BackgroundLock lock(shared.mutex);
    if (shared.map.find_keyframe(id) == nullptr) return std::vector<KeyframeId>();
    return shared.map.covisible_keyframes(id, kNeighbours, kMinShared);
  };
}

// The unit of length may have changed at either end of a loop.
void rescale(LoopMatch& loop, const MapCorrection& correction) {
  const double query = correction.scale_of(loop.query), match = correction.scale_of(loop.match);
  loop.S_query_match.s *= query / match;
  loop.S_query_match.t *= query;
}

}  // namespace

LoopCloser::LoopCloser(const DepthCamera& camera, const SystemOptions& options,
                       const std::vector<float>& scale_factors, loop::Vocabulary vocabulary,
                       SharedMap& shared)
    : camera_(camera),
      options_(options.loops),
      with_scale_(options.sensor == Sensor::kMono),
      bundle_adjustment_(options.bundle_adjustment && options.loops.bundle_adjustment),
      scale_factors_(scale_factors),
      shared_(shared),
      database_(std::move(vocabulary), options.loops, neighbours_in(shared)),
      check_(camera, scale_factors, options, shared, database_),
      fusion_(camera, scale_factors),
      next_training_(database_.ready() ? 0 : static_cast<std::size_t>(options_.first_vocabulary)) {}

// What a feature counts: what its map point is believed to stand still; nothing on a mover.
KeyframeLook LoopCloser::look_of(const Map& map, KeyframeId id) const {
  const Keyframe& keyframe = map.keyframe(id);
  KeyframeLook look{id, keyframe.features, std::vector<float>(keyframe.features->size(), 1.0F)};
  for (std::size_t i = 0; i < look.weights.size(); ++i) {
    const MapPoint* point = map.find_point(keyframe.points[i]);
    if (point != nullptr) {
      look.weights[i] = point->static_weight;
    } else if (!keyframe.moving.empty() && keyframe.moving[i] != 0) {
      look.weights[i] = 0.0F;
    }
  }
  return look;
}

// Keyframes to which no loop leads: a loop has joined their place before and the query still sees
// it, or the camera has had it in view all the time. A place is left when several keyframes in a
// row do not see it; that tracking has found its points again by itself does not matter the first
// time that the camera comes back.
std::vector<KeyframeId> LoopCloser::never_left(const Map& map, KeyframeId query) const {
  const std::vector<KeyframeId> all = map.keyframe_ids();
  std::vector<KeyframeId> ids;
  for (std::size_t c = 0; c < all.size() && all[c] != query; ++c) {
    const auto& covisible = map.keyframe(all[c]).covisible;
    const auto sees_it = [&](KeyframeId id) {
      const auto found = covisible.find(id);
      return id == all[c] || (found != covisible.end() && found->second >= kMinShared);
    };
    std::unordered_set<KeyframeId> returned;  // keyframes that closed a loop here
    for (const LoopMatch& loop : closed_) {
      if (sees_it(loop.match) || sees_it(loop.query)) returned.insert(loop.query);
    }
    const bool joined = !returned.empty() && sees_it(query);
    int missed = 0;
    bool left = false;
    for (std::size_t k = c + 1; k < all.size() && all[k] != query && !joined; ++k) {
      missed = sees_it(all[k]) ? 0 : missed + 1;
      left = (left || missed >= options_.consistency) && returned.count(all[k]) == 0;
    }
    if (!left) ids.push_back(all[c]);
  }
  return ids;
}

// Keyframes that nobody looked from: the two that begin a map without depth come as a pair.
void LoopCloser::store_unseen(const Map& map, KeyframeId query) {
  for (const KeyframeId id : map.keyframe_ids()) {
    const bool known = std::find(stored_.begin(), stored_.end(), id) != stored_.end();
    if (known || map.keyframe(id).number >= map.keyframe(query).number) continue;
    stored_.push_back(id);
    if (database_.ready()) database_.add(look_of(map, id));
  }
}

void LoopCloser::forget_erased() {
  std::vector<KeyframeId> erased;
  {
    const BackgroundLock lock(shared_.mutex);
    const auto is_gone = [&](KeyframeId id) { return shared_.map.find_keyframe(id) == nullptr; };
    std::copy_if(stored_.begin(), stored_.end(), std::back_inserter(erased), is_gone);
    const auto joins_nothing = [&](const LoopMatch& loop) {
      return is_gone(loop.query) && is_gone(loop.match);
    };
    closed_.erase(std::remove_if(closed_.begin(), closed_.end(), joins_nothing), closed_.end());
  }
  for (const KeyframeId id : erased) {
    database_.remove(id);
    stored_.erase(std::remove(stored_.begin(), stored_.end(), id), stored_.end());
  }
}

// True if it trained: all keyframes are stored under the new vocabulary then.
bool LoopCloser::train_if_due() {
  if (next_training_ == 0 || stored_.size() < next_training_) return false;
  std::vector<KeyframeLook> looks;
  for (const KeyframeId id : stored_) {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.find_keyframe(id) != nullptr) looks.push_back(look_of(shared_.map, id));
  }
  next_training_ = kTrainingGrowth * stored_.size();
  return database_.train(looks);
}

void LoopCloser::adopt_map() {
  std::vector<KeyframeLook> looks;
  {
    const BackgroundLock lock(shared_.mutex);
    stored_ = shared_.map.keyframe_ids();
    for (const KeyframeId id : stored_) looks.push_back(look_of(shared_.map, id));
  }
  if (database_.ready()) {
    for (const KeyframeLook& look : looks) database_.add(look);
  } else if (database_.train(looks)) {
    next_training_ = kTrainingGrowth * stored_.size();
  }
}

void LoopCloser::process(KeyframeId id, const std::atomic<bool>& stop) {
  forget_erased();
  KeyframeLook look;
  std::vector<KeyframeId> covisible;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.find_keyframe(id) == nullptr) return;
    look = look_of(shared_.map, id);
    covisible = never_left(shared_.map, id);
    store_unseen(shared_.map, id);
  }
  stored_.push_back(id);
  if (train_if_due() || !database_.ready() || stop) return;
  std::unordered_map<KeyframeId, LoopMatch> matches;
  const loop::LoopResult result =
      database_.detect(look, covisible, [&](std::uint64_t query, std::uint64_t candidate) {
        return check_.verify(query, candidate, matches[candidate]);
      });
  if (result && !stop) close(matches.at(result.match), stop);
}

void LoopCloser::close(const LoopMatch& match, const std::atomic<bool>& stop) {
  const auto centre = [&] {
    const BackgroundLock lock(shared_.mutex);
    const Keyframe* query = shared_.map.find_keyframe(match.query);
    return query == nullptr ? Eigen::Vector3d::Zero().eval() : query->T_cam_world.inverse().t;
  };
  const Eigen::Vector3d before = centre();
  if (!correct(match)) return;
  database_.forget_queries();
  fuse(match, stop);
  if (bundle_adjustment_ && !stop) adjust_all(stop);
  const double moved = (centre() - before).norm();
  const BackgroundLock lock(shared_.mutex);
  closures_.back().moved = moved;
}

// Spreads the loop's error over the essential graph. Where tracking has found the old points by
// itself there is none left that the bundle adjustment would not see.
bool LoopCloser::correct(const LoopMatch& match) {
  EssentialGraph graph(with_scale_);
  {
    const BackgroundLock lock(shared_.mutex);
    graph.collect(shared_.map, closed_);
  }
  if (!graph.add_loop(match) || !graph.solve()) return false;
  const MapCorrection correction = graph.correction();
  const BackgroundLock lock(shared_.mutex);
  const Keyframe* query = shared_.map.find_keyframe(match.query);
  const Keyframe* old = shared_.map.find_keyframe(match.match);
  if (query == nullptr || old == nullptr) return false;
  LoopClosure closure;
  closure.query_frame = query->frame_index;
  closure.match_frame = old->frame_index;
  closure.query_timestamp = query->timestamp;
  closure.match_timestamp = old->timestamp;
  closure.T_query_match = match.S_query_match.rigid();
  closure.scale = match.S_query_match.s;
  closure.inliers = match.inliers;
  closure.visible = match.visible;
  const auto shared = query->covisible.find(match.match);
  closure.shared = shared == query->covisible.end() ? 0 : shared->second;
  closures_.push_back(closure);
  closed_.push_back(match);
  closed_.back().points = {};  // which serve the fusion only
  if (closure.shared < kMinShared) {
    correction.apply(shared_);
    for (LoopMatch& loop : closed_) rescale(loop, correction);
  }
  return true;
}

// What both sides of the loop see becomes one, in the query and around it.
void LoopCloser::fuse(const LoopMatch& match, const std::atomic<bool>& stop) {
  LocalMap place;
  std::vector<KeyframeId> around;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.find_keyframe(match.query) == nullptr) return;
    for (const auto& [feature, point] : match.points) {
      fusion_.join(shared_.map, point, {match.query, feature}, {});
    }
    around = shared_.map.covisible_keyframes(match.query, kFuseKeyframes, kMinShared);
    around.insert(around.begin(), match.query);
    place.collect(shared_.map, {}, match.match, kPlaceKeyframes);
  }
  for (const KeyframeId keyframe : around) {
    if (stop) return;
    fusion_.fuse(shared_, place.ids, keyframe);
  }
}

// All keyframes and points; tracking and local mapping go on meanwhile.
void LoopCloser::adjust_all(const std::atomic<bool>& stop) {
  MapBundle bundle;
  {
    const BackgroundLock lock(shared_.mutex);
    if (shared_.map.keyframe_count() == 0) return;
    bundle.collect_all(shared_.map, scale_factors_);
  }
  if (!bundle.solve(camera_, workspace_, stop)) return;
  const BackgroundLock lock(shared_.mutex);
  bundle.write_back_and_carry(shared_);
}

}  // namespace dynslam::slam
