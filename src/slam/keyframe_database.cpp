#include "keyframe_database.hpp"

#include <algorithm>
#include <utility>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary_training.hpp"

namespace dynslam::slam {
namespace {

constexpr int kMatchLevel = 2;  // level of the tree whose nodes hold the candidates of a match
constexpr std::size_t kTrainingRows = 100000;  // descriptors that train a vocabulary, at most
constexpr double kRowsOfAWord = 10.0;          // descriptors that a word is made of

loop::LoopDetectorOptions detector_options(const LoopOptions& options) {
  loop::LoopDetectorOptions result;
  result.grouping = loop::Grouping::kCovisibility;
  result.exclude_recent = 0;  // the closer names what has been in view
  result.consistency = options.consistency;
  return result;
}

loop::TrainingOptions training_options(std::size_t rows) {
  loop::TrainingOptions options;
  options.levels = 3;
  for (double words = 1e3; words < static_cast<double>(rows) / kRowsOfAWord && options.levels < 6;
       words *= 10.0) {
    ++options.levels;
  }
  return options;
}

}  // namespace

KeyframeDatabase::State::State(loop::Vocabulary vocabulary_, const LoopOptions& options,
                               loop::NeighboursOf neighbours)
    : vocabulary(std::move(vocabulary_)),
      detector(loop::Database(vocabulary.words(), vocabulary.scoring()), detector_options(options),
               std::move(neighbours)) {}

KeyframeDatabase::KeyframeDatabase(loop::Vocabulary vocabulary, const LoopOptions& options,
                                   loop::NeighboursOf neighbours)
    : options_(options), neighbours_(std::move(neighbours)) {
  if (vocabulary.empty()) return;
  state_ = std::make_shared<State>(std::move(vocabulary), options_, neighbours_);
}

std::shared_ptr<KeyframeDatabase::State> KeyframeDatabase::state() const {
  const std::lock_guard<std::mutex> guard(mutex_);
  return state_;
}

bool KeyframeDatabase::train(const std::vector<KeyframeLook>& keyframes) {
  std::size_t rows = 0;
  for (const KeyframeLook& keyframe : keyframes) rows += keyframe.features->size();
  const std::size_t step = 1 + rows / kTrainingRows;  // every step-th keyframe is enough
  std::vector<std::uint8_t> descriptors;
  std::vector<std::size_t> ends;
  for (std::size_t k = 0; k < keyframes.size(); k += step) {
    const FrameFeatures& features = *keyframes[k].features;
    for (std::size_t i = 0; i < features.size(); ++i) {
      if (!(keyframes[k].weights[i] > 0.0F)) continue;
      const std::uint8_t* row = features.descriptor(i);
      descriptors.insert(descriptors.end(), row, row + 32);
    }
    ends.push_back(descriptors.size() / 32);
  }
  if (ends.size() < 2) return false;
  const DescriptorsView view(descriptors.data(), 32, static_cast<int>(ends.back()));
  std::shared_ptr<State> trained;
  try {
    trained = std::make_shared<State>(
        loop::train_vocabulary(view, ends, training_options(ends.back())), options_, neighbours_);
  } catch (const InvalidArgument&) {
    return false;  // fewer than two different descriptors
  }
  for (const KeyframeLook& keyframe : keyframes) {
    trained->detector.add(keyframe.id, put_in_words(*trained, keyframe).bow);
  }
  const std::lock_guard<std::mutex> guard(mutex_);
  state_ = std::move(trained);
  return true;
}

const KeyframeWords& KeyframeDatabase::put_in_words(State& state, const KeyframeLook& keyframe) {
  KeyframeWords& words = state.words[keyframe.id];
  loop::Features features;
  features.descriptors = keyframe.features->descriptors_view();
  features.weights = keyframe.weights;
  const int levels_up = std::max(0, state.vocabulary.levels() - kMatchLevel);
  state.vocabulary.transform(features, words.bow, &words.direct, levels_up, state.workspace);
  return words;
}

void KeyframeDatabase::add(const KeyframeLook& keyframe) {
  const std::shared_ptr<State> now = state();
  now->detector.add(keyframe.id, put_in_words(*now, keyframe).bow);
}

void KeyframeDatabase::remove(KeyframeId id) {
  const std::shared_ptr<State> now = state();
  if (now == nullptr) return;
  now->detector.remove(id);
  now->words.erase(id);
}

const KeyframeWords& KeyframeDatabase::words(KeyframeId id) const { return state()->words.at(id); }

loop::LoopResult KeyframeDatabase::detect(const KeyframeLook& keyframe,
                                          Span<const KeyframeId> covisible,
                                          const loop::VerifyLoop& verify) {
  const std::shared_ptr<State> now = state();
  loop::LoopQuery query;
  query.id = keyframe.id;
  query.bow = &put_in_words(*now, keyframe).bow;
  query.covisible = covisible;
  const loop::LoopResult result = now->detector.detect(query, verify);
  now->detector.add(keyframe.id, *query.bow);
  return result;
}

void KeyframeDatabase::forget_queries() { state()->detector.forget_queries(); }

std::vector<KeyframeId> KeyframeDatabase::similar(const FrameFeatures& features,
                                                  std::size_t count) const {
  const std::shared_ptr<State> now = state();
  if (now == nullptr) return {};
  loop::Features wanted;
  wanted.descriptors = features.descriptors_view();
  loop::QueryOptions options;
  options.max_results = count;
  std::vector<KeyframeId> ids;
  for (const loop::QueryResult& found :
       now->detector.database().query(now->vocabulary.transform(wanted), options)) {
    ids.push_back(found.id);
  }
  return ids;
}

}  // namespace dynslam::slam
