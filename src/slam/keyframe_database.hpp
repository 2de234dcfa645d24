// Keyframes by their looks: for loops, and for a camera that is lost.
#pragma once

#include <cstddef>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "dynslam/loop/loop_detector.hpp"
#include "dynslam/loop/vocabulary.hpp"
#include "dynslam/slam/frame.hpp"
#include "dynslam/slam/loop_options.hpp"
#include "dynslam/slam/map.hpp"

namespace dynslam::slam {

/// A keyframe as the database sees it.
struct KeyframeLook {
  KeyframeId id = kNoId;
  FrameFeaturesPtr features;
  std::vector<float> weights;  ///< by feature, 0..1: what it counts; 0 = it shows a mover
};

/// A keyframe in words, and which features fell under which node of the tree.
struct KeyframeWords {
  loop::BowVector bow;
  loop::FeatureVector direct;
};

/// Vocabulary, inverted index and loop detector over the keyframes of a map.
///
/// One thread (the loop worker) changes it; `ready` and `similar` may be called by another
/// meanwhile. Empty, and of no use, until there is a vocabulary.
class KeyframeDatabase {
 public:
  /// `neighbours`: keyframes covisible with one, for the consistency of loops.
  KeyframeDatabase(loop::Vocabulary vocabulary, const LoopOptions& options,
                   loop::NeighboursOf neighbours);

  bool ready() const { return state() != nullptr; }

  /// Trains a vocabulary on keyframes and stores them under it, in place of what there was. What
  /// looks the same everywhere trains nothing: false then. O(descriptors), seconds for 10^6.
  bool train(const std::vector<KeyframeLook>& keyframes);

  /// Looks for the place of a keyframe among the stored ones that are not covisible with it, then
  /// stores it. Needs `ready`. `verify` may ask for its words.
  loop::LoopResult detect(const KeyframeLook& keyframe, Span<const KeyframeId> covisible,
                          const loop::VerifyLoop& verify);
  /// Stores a keyframe without looking for its place. Needs `ready`.
  void add(const KeyframeLook& keyframe);
  void remove(KeyframeId id);
  /// Words of a keyframe that is stored or being detected.
  const KeyframeWords& words(KeyframeId id) const;
  /// Takes the keyframes before out of the consistency of the next ones.
  void forget_queries();

  /// Keyframes that look most like a frame, best first; none without a vocabulary.
  std::vector<KeyframeId> similar(const FrameFeatures& features, std::size_t count) const;

 private:
  struct State {
    State(loop::Vocabulary vocabulary, const LoopOptions& options, loop::NeighboursOf neighbours);
    loop::Vocabulary vocabulary;
    loop::LoopDetector detector;
    std::unordered_map<KeyframeId, KeyframeWords> words;
    loop::TransformWorkspace workspace;
  };
  std::shared_ptr<State> state() const;
  static const KeyframeWords& put_in_words(State& state, const KeyframeLook& keyframe);

  LoopOptions options_;
  loop::NeighboursOf neighbours_;
  mutable std::mutex mutex_;  // over state_ itself; what it points to is the loop worker's
  std::shared_ptr<State> state_;
};

}  // namespace dynslam::slam
