#include "dynslam/loop/vocabulary.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"

#include "loop/radix_sort.hpp"
#include "loop/vocabulary_block.hpp"
#include "loop/walk_kernels.hpp"

namespace dynslam::loop {

struct TransformWorkspace::State {
  std::vector<std::uint32_t> kept;
  std::vector<WordId> words;
  std::vector<NodeId> nodes;
  std::vector<std::uint64_t> keys;
  std::vector<std::uint64_t> scratch;
};

TransformWorkspace::TransformWorkspace() : state_(std::make_unique<State>()) {}
TransformWorkspace::~TransformWorkspace() = default;
TransformWorkspace::TransformWorkspace(TransformWorkspace&&) noexcept = default;
TransformWorkspace& TransformWorkspace::operator=(TransformWorkspace&&) noexcept = default;

namespace {

std::size_t rows_of(DescriptorsView descriptors) {
  return descriptors.empty() ? 0 : static_cast<std::size_t>(descriptors.height);
}

void require_width(const char* where, DescriptorsView descriptors, int bytes) {
  require(descriptors.empty() || descriptors.width == bytes, where, "descriptors.width",
          descriptors.width, bytes);
}

void check_features(const char* where, const Features& features) {
  const std::size_t rows = rows_of(features.descriptors);
  require(features.keep.empty() || features.keep.size() == rows, where, "keep.size()",
          features.keep.size(), "0 or " + std::to_string(rows));
  require(features.weights.empty() || features.weights.size() == rows, where, "weights.size()",
          features.weights.size(), "0 or " + std::to_string(rows));
  for (const float weight : features.weights) {
    if (!(weight >= 0.0F && weight <= 1.0F)) {
      throw_invalid_argument(where, "weights[i]", weight, "a number within [0, 1]");
    }
  }
}

detail::Walk walk_of(const detail::VocabularyBlock& block, DescriptorsView descriptors) {
  detail::Walk walk;
  walk.tree = block.tree();
  walk.descriptor_bytes = block.header.descriptor_bytes;
  walk.fetch_bytes = detail::block_bytes(block.header.k, block.stride());
  walk.rows = descriptors.data;
  walk.row_stride = descriptors.stride_bytes;
  walk.count = rows_of(descriptors);
  return walk;
}

/// Sums the weights of equal words. Real is the type that sums are kept in.
template <typename Real>
class Counter {
 public:
  Counter(const detail::VocabularyBlock& block, const Features& features, BowVector& bow)
      : weights_(block.weights()), factors_(features.weights), bow_(bow) {
    const auto weighting = static_cast<Weighting>(block.header.weighting);
    sums_ = weighting == Weighting::kTfIdf || weighting == Weighting::kTf;
  }

  /// `keys`: word above, row below, ascending words.
  void operator()(const std::vector<std::uint64_t>& keys) {
    bow_.clear();
    for (std::size_t i = 0; i < keys.size();) {
      const WordId word = static_cast<WordId>(keys[i] >> 32);
      Real value = 0;
      for (; i < keys.size() && keys[i] >> 32 == word; ++i) {
        const std::uint32_t row = static_cast<std::uint32_t>(keys[i]);
        Real one = static_cast<Real>(weights_[word]);
        if (!factors_.empty()) one *= static_cast<Real>(factors_[row]);
        value = sums_ ? value + one : std::max(value, one);
      }
      bow_.push_back(word, value);
    }
  }

 private:
  const double* weights_;
  Span<const float> factors_;
  BowVector& bow_;
  bool sums_;
};

/// As FBoW does it: single precision, always L2.
void normalize_single(BowVector& bow) {
  double sum = 0.0;
  for (const double w : bow.weights()) {
    const float value = static_cast<float>(w);
    sum += static_cast<double>(value * value);
  }
  if (!(sum > 0.0)) return;
  const double factor = 1.0 / std::sqrt(sum);
  bow.transform_weights([factor](double w) { return static_cast<float>(w * factor); });
}

}  // namespace

Vocabulary::Vocabulary(std::shared_ptr<const detail::VocabularyBlock> block)
    : block_(std::move(block)) {}

const detail::VocabularyBlock& Vocabulary::block() const {
  require(block_ != nullptr, "Vocabulary", "this", "an empty vocabulary", "one that was loaded");
  return *block_;
}

int Vocabulary::k() const { return empty() ? 0 : static_cast<int>(block_->header.k); }
int Vocabulary::levels() const { return empty() ? 0 : static_cast<int>(block_->header.levels); }
std::size_t Vocabulary::words() const { return empty() ? 0 : block_->header.words; }
std::size_t Vocabulary::nodes() const { return empty() ? 0 : block_->header.nodes; }
int Vocabulary::descriptor_bytes() const {
  return empty() ? 0 : static_cast<int>(block_->header.descriptor_bytes);
}
Weighting Vocabulary::weighting() const { return static_cast<Weighting>(block().header.weighting); }
Scoring Vocabulary::scoring() const { return static_cast<Scoring>(block().header.scoring); }
std::size_t Vocabulary::bytes() const { return empty() ? 0 : block_->header.file_bytes; }
bool Vocabulary::single_precision() const { return block().header.single_precision != 0; }

double Vocabulary::word_weight(WordId word) const {
  require(word < block().header.words, "Vocabulary::word_weight", "word", word,
          "a number below " + std::to_string(words()));
  return block_->weights()[word];
}

Vocabulary Vocabulary::with(Weighting weighting, Scoring scoring) const {
  auto changed = std::make_shared<detail::VocabularyBlock>(block());
  changed->header.weighting = static_cast<std::uint32_t>(weighting);
  changed->header.scoring = static_cast<std::uint32_t>(scoring);
  changed->header.single_precision = 0;
  return Vocabulary(std::move(changed));
}

void Vocabulary::find_words(DescriptorsView descriptors, Span<WordId> words) const {
  constexpr const char* where = "Vocabulary::find_words";
  const detail::VocabularyBlock& b = block();
  require_width(where, descriptors, descriptor_bytes());
  require(words.size() == rows_of(descriptors), where, "words.size()", words.size(),
          rows_of(descriptors));
  if (words.empty()) return;
  detail::walk_down(walk_of(b, descriptors), words.data(), nullptr);
}

void Vocabulary::transform(const Features& features, BowVector& bow, FeatureVector* direct,
                           int levels_up, TransformWorkspace& workspace) const {
  constexpr const char* where = "Vocabulary::transform";
  const detail::VocabularyBlock& b = block();
  require_width(where, features.descriptors, descriptor_bytes());
  check_features(where, features);
  require(levels_up >= 0, where, "levels_up", levels_up, "a number >= 0");

  TransformWorkspace::State& state = *workspace.state_;
  const std::size_t rows = rows_of(features.descriptors);
  state.kept.clear();
  for (std::size_t row = 0; row < rows; ++row) {
    if (!features.keep.empty() && features.keep[row] == 0) continue;
    if (!features.weights.empty() && features.weights[row] == 0.0F) continue;
    state.kept.push_back(static_cast<std::uint32_t>(row));
  }
  state.words.resize(state.kept.size());
  state.nodes.resize(state.kept.size());
  if (!state.kept.empty()) {
    detail::Walk walk = walk_of(b, features.descriptors);
    walk.kept = state.kept.data();
    walk.count = state.kept.size();
    walk.node_level = std::max(levels() - std::min(levels_up, levels()), 0);
    detail::walk_down(walk, state.words.data(), direct != nullptr ? state.nodes.data() : nullptr);
  }

  // Stopped words go; what stays is counted in the order of the words, and of rows within one.
  state.keys.clear();
  std::size_t left = 0;
  for (std::size_t i = 0; i < state.kept.size(); ++i) {
    if (!(b.weights()[state.words[i]] > 0.0)) continue;
    state.keys.push_back(std::uint64_t{state.words[i]} << 32 | state.kept[i]);
    state.kept[left] = state.kept[i];
    state.nodes[left++] = b.ids() != nullptr ? b.ids()[state.nodes[i]] : state.nodes[i];
  }
  detail::sort_by_upper_half(state.keys, state.scratch);
  if (single_precision()) {
    Counter<float>(b, features, bow)(state.keys);
    normalize_single(bow);
  } else {
    Counter<double>(b, features, bow)(state.keys);
    const Norm norm = norm_of(scoring());
    if (norm == Norm::kNone && weighting() != Weighting::kIdf &&
        weighting() != Weighting::kBinary) {
      const double words = static_cast<double>(bow.size());
      bow.transform_weights([words](double w) { return w / words; });
    }
    bow.normalize(norm);
  }
  if (direct == nullptr) return;
  state.nodes.resize(left);
  state.kept.resize(left);
  direct->assign(state.nodes, state.kept);
}

BowVector Vocabulary::transform(const Features& features) const {
  BowVector bow;
  TransformWorkspace workspace;
  transform(features, bow, nullptr, 0, workspace);
  return bow;
}

void Vocabulary::transform(const Features& features, int levels_up, BowVector& bow,
                           FeatureVector& direct) const {
  TransformWorkspace workspace;
  transform(features, bow, &direct, levels_up, workspace);
}

double Vocabulary::score(const BowVector& a, const BowVector& b) const {
  return loop::score(scoring(), a, b);
}

}  // namespace dynslam::loop
