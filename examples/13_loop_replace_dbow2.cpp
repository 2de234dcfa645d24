// DBoW2 replaced in a keyframe database as the ORB-SLAM family has it.
//
// The class below has the interface that such systems call: add, erase, clear, loop candidates
// above the least score of the covisible keyframes, relocalization candidates. Keyframe and Frame
// are plain stand-ins with the members that matter; in your system they are your own.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <map>
#include <mutex>
#include <random>
#include <unordered_map>
#include <vector>

#include "dynslam/loop/database.hpp"
#include "dynslam/loop/vocabulary.hpp"
#include "dynslam/loop/vocabulary_training.hpp"

namespace loop = dynslam::loop;

namespace host {

struct Frame {
  std::vector<std::uint8_t> descriptors;  // 32 bytes a feature
  loop::BowVector words;                  // instead of DBoW2::BowVector
  loop::FeatureVector direct;             // instead of DBoW2::FeatureVector
};

struct KeyFrame : Frame {
  std::uint64_t id = 0;
  std::vector<KeyFrame*> neighbours;  // best covisible keyframes

  void compute_bow(const loop::Vocabulary& vocabulary) {
    loop::Features features;
    features.descriptors = {descriptors.data(), 32, static_cast<int>(descriptors.size() / 32)};
    vocabulary.transform(features, 4, words, direct);  // levels up, as there
  }
};

/// Keyframes by their words. Calls from the tracking and the loop closing thread may overlap.
class KeyFrameDatabase {
 public:
  explicit KeyFrameDatabase(const loop::Vocabulary& vocabulary)
      : database_(vocabulary.words(), vocabulary.scoring()) {}

  void add(KeyFrame* keyframe) {
    const std::lock_guard<std::mutex> lock(mutex_);
    database_.add(keyframe->id, keyframe->words);
    keyframes_[keyframe->id] = keyframe;
  }

  void erase(KeyFrame* keyframe) {
    const std::lock_guard<std::mutex> lock(mutex_);
    database_.remove(keyframe->id);
    keyframes_.erase(keyframe->id);
  }

  void clear() {
    const std::lock_guard<std::mutex> lock(mutex_);
    database_.clear();
    keyframes_.clear();
  }

  /// Best keyframes of the groups whose accumulated score is at least 0.75 of the best one's, among
  /// those that score at least `min_score` and are not covisible with the query.
  std::vector<KeyFrame*> detect_loop_candidates(const KeyFrame& query, double min_score) const {
    std::vector<std::uint64_t> connected = {query.id};
    for (const KeyFrame* neighbour : query.neighbours) connected.push_back(neighbour->id);
    loop::QueryOptions options;
    options.max_results = 0;
    options.worst_score = min_score;
    options.excluded = connected;
    return best_groups(database_.query(query.words, options));
  }

  std::vector<KeyFrame*> detect_relocalization_candidates(const Frame& frame) const {
    loop::QueryOptions options;
    options.max_results = 0;
    return best_groups(database_.query(frame.words, options));
  }

  /// What the loop closer asks first: the least score against the covisible keyframes.
  double least_neighbour_score(const KeyFrame& query) const {
    std::vector<std::uint64_t> ids;
    for (const KeyFrame* neighbour : query.neighbours) ids.push_back(neighbour->id);
    std::vector<double> scores(ids.size());
    database_.scores(query.words, ids, scores);
    double least = 1.0;
    for (const double score : scores) {
      if (score < least) least = score;  // NaN, not stored, is not less
    }
    return least;
  }

 private:
  std::vector<KeyFrame*> best_groups(const std::vector<loop::QueryResult>& results) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::unordered_map<std::uint64_t, double> score_of;
    for (const loop::QueryResult& result : results) score_of[result.id] = result.score;
    std::map<KeyFrame*, double> group_of;  // best keyframe of a group and the group's score
    double best_sum = 0.0;
    for (const loop::QueryResult& result : results) {
      const auto found = keyframes_.find(result.id);
      if (found == keyframes_.end()) continue;  // erased since
      KeyFrame* best = found->second;
      double best_score = result.score, sum = result.score;
      for (KeyFrame* neighbour : found->second->neighbours) {
        const auto scored = score_of.find(neighbour->id);
        if (scored == score_of.end()) continue;
        sum += scored->second;
        if (scored->second > best_score) best = neighbour, best_score = scored->second;
      }
      group_of[best] = std::max(group_of[best], sum);
      best_sum = std::max(best_sum, sum);
    }
    std::vector<KeyFrame*> candidates;
    for (const auto& [keyframe, sum] : group_of) {
      if (sum > 0.75 * best_sum) candidates.push_back(keyframe);
    }
    std::sort(candidates.begin(), candidates.end(),
              [](const KeyFrame* a, const KeyFrame* b) { return a->id < b->id; });
    return candidates;
  }

  loop::Database database_;
  mutable std::mutex mutex_;  // of the map below; the database locks for itself
  std::unordered_map<std::uint64_t, KeyFrame*> keyframes_;
};

}  // namespace host

int main() {
  // Thirty places of 200 descriptors; each keyframe sees its place and a part of the next one.
  std::mt19937 random(1);
  std::vector<std::uint8_t> world(31 * 200 * 32);
  for (std::uint8_t& byte : world) byte = static_cast<std::uint8_t>(random());
  const auto see = [&](std::size_t place) {
    std::vector<std::uint8_t> seen(
        world.begin() + static_cast<std::ptrdiff_t>(place * 6400),
        world.begin() + static_cast<std::ptrdiff_t>(place * 6400 + 9600));
    for (std::size_t i = 0; i < seen.size(); i += 16) seen[i] ^= 1U;  // never quite the same
    return seen;
  };
  loop::TrainingOptions training;
  training.levels = 3;
  std::vector<std::size_t> ends;
  for (std::size_t place = 1; place <= 31; ++place) ends.push_back(place * 200);
  const loop::Vocabulary vocabulary =
      loop::train_vocabulary({world.data(), 32, 31 * 200}, ends, training);

  std::vector<host::KeyFrame> keyframes(30);
  host::KeyFrameDatabase database(vocabulary);
  for (std::size_t i = 0; i < keyframes.size(); ++i) {
    keyframes[i].id = i;
    keyframes[i].descriptors = see(i);
    keyframes[i].compute_bow(vocabulary);
    if (i > 0) {
      keyframes[i].neighbours.push_back(&keyframes[i - 1]);
      keyframes[i - 1].neighbours.push_back(&keyframes[i]);
    }
    database.add(&keyframes[i]);
  }
  host::KeyFrame back;
  back.id = 100;
  back.descriptors = see(5);
  back.neighbours = {&keyframes[29]};
  back.compute_bow(vocabulary);
  std::printf("back at the place of keyframe 5, least neighbour score %.3f\n",
              database.least_neighbour_score(back));
  const auto loops =
      database.detect_loop_candidates(back, 0.1 + database.least_neighbour_score(back));
  for (const host::KeyFrame* keyframe : loops)
    std::printf("  loop candidate: keyframe %d\n", int(keyframe->id));
  database.erase(&keyframes[5]);
  const auto others = database.detect_relocalization_candidates(back);
  for (const host::KeyFrame* keyframe : others)
    std::printf("  without keyframe 5, relocalization candidate: %d\n", int(keyframe->id));
  return loops.size() == 1 && loops[0]->id == 5 ? 0 : 1;
}
