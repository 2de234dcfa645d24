#include "dynslam/loop/bow_vector.hpp"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <numeric>

#include "dynslam/core/errors.hpp"

namespace dynslam::loop {
namespace {

/// First position in [begin, words.size()) whose word is not below `word`. Doubling steps: as
/// cheap as a merge where both vectors are equally dense, logarithmic where one is not.
std::size_t seek(Span<const WordId> words, std::size_t begin, WordId word) {
  std::size_t step = 1;
  std::size_t end = begin;
  while (end < words.size() && words[end] < word) {
    begin = end + 1;
    end += step;
    step *= 2;
  }
  const WordId* first = words.data() + begin;
  const WordId* last = words.data() + std::min(end, words.size());
  return static_cast<std::size_t>(std::lower_bound(first, last, word) - words.data());
}

/// term(v_i, w_i) for every word of both, in the order of the words.
template <typename Term>
void for_each_common(const BowVector& a, const BowVector& b, Term term) {
  const Span<const WordId> words_a = a.words();
  const Span<const WordId> words_b = b.words();
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < words_a.size() && j < words_b.size()) {
    if (words_a[i] == words_b[j]) {
      term(a.weight(i++), b.weight(j++));
    } else if (words_a[i] < words_b[j]) {
      i = seek(words_a, i + 1, words_b[j]);
    } else {
      j = seek(words_b, j + 1, words_a[i]);
    }
  }
}

}  // namespace

Norm norm_of(Scoring scoring) {
  switch (scoring) {
    case Scoring::kL2:
      return Norm::kL2;
    case Scoring::kDotProduct:
      return Norm::kNone;
    default:
      return Norm::kL1;
  }
}

double BowVector::weight_of(WordId word) const {
  const auto at = std::lower_bound(words_.begin(), words_.end(), word);
  if (at == words_.end() || *at != word) return 0.0;
  return weights_[static_cast<std::size_t>(at - words_.begin())];
}

void BowVector::clear() {
  words_.clear();
  weights_.clear();
}

void BowVector::reserve(std::size_t size) {
  words_.reserve(size);
  weights_.reserve(size);
}

void BowVector::push_back(WordId word, double weight) {
  if (!words_.empty()) {
    require(word > words_.back(), "BowVector::push_back", "word", word,
            "a word above the last one");
  }
  require(std::isfinite(weight), "BowVector::push_back", "weight", weight, "a finite number");
  words_.push_back(word);
  weights_.push_back(weight);
}

void BowVector::add(WordId word, double weight) {
  require(std::isfinite(weight), "BowVector::add", "weight", weight, "a finite number");
  const auto at = std::lower_bound(words_.begin(), words_.end(), word);
  const std::ptrdiff_t i = at - words_.begin();
  if (at != words_.end() && *at == word) {
    weights_[static_cast<std::size_t>(i)] += weight;
  } else {
    words_.insert(at, word);
    weights_.insert(weights_.begin() + i, weight);
  }
}

void BowVector::normalize(Norm norm) {
  double sum = 0.0;
  switch (norm) {
    case Norm::kNone:
      return;
    case Norm::kL1:
      for (const double w : weights_) sum += std::abs(w);
      break;
    case Norm::kL2:
      for (const double w : weights_) sum += w * w;
      sum = std::sqrt(sum);
      break;
  }
  if (sum > 0.0) {
    for (double& w : weights_) w /= sum;
  }
}

void FeatureVector::clear() {
  nodes_.clear();
  begins_.assign(1, 0);
  features_.clear();
}

void FeatureVector::assign(Span<const NodeId> nodes, Span<const std::uint32_t> rows) {
  require(rows.empty() || rows.size() == nodes.size(), "FeatureVector::assign", "rows.size()",
          rows.size(), nodes.size());
  // A node above, its feature below: sorting the numbers sorts by node, then by feature.
  std::vector<std::uint64_t> keys(nodes.size());
  for (std::size_t f = 0; f < nodes.size(); ++f) {
    const std::uint32_t row = rows.empty() ? static_cast<std::uint32_t>(f) : rows[f];
    keys[f] = std::uint64_t{nodes[f]} << 32 | row;
  }
  std::sort(keys.begin(), keys.end());
  clear();
  features_.reserve(keys.size());
  for (const std::uint64_t key : keys) {
    const NodeId node = static_cast<NodeId>(key >> 32);
    if (nodes_.empty() || nodes_.back() != node) {
      nodes_.push_back(node);
      begins_.push_back(begins_.back());
    }
    features_.push_back(static_cast<std::uint32_t>(key));
    ++begins_.back();
  }
}

double l1_score(const BowVector& a, const BowVector& b) {
  double sum = 0.0;
  for_each_common(
      a, b, [&sum](double v, double w) { sum += std::abs(v - w) - std::abs(v) - std::abs(w); });
  return sum == 0.0 ? 0.0 : -sum / 2.0;
}

double l2_score(const BowVector& a, const BowVector& b) {
  const double sum = dot_product_score(a, b);
  return sum >= 1.0 ? 1.0 : 1.0 - std::sqrt(1.0 - sum);
}

double chi_square_score(const BowVector& a, const BowVector& b) {
  double sum = 0.0;
  for_each_common(a, b, [&sum](double v, double w) {
    if (v + w != 0.0) sum += v * w / (v + w);
  });
  return 2.0 * sum;
}

double kullback_leibler_score(const BowVector& a, const BowVector& b) {
  const double log_epsilon = std::log(DBL_EPSILON);
  double sum = 0.0;
  std::size_t j = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double v = a.weight(i);
    j = seek(b.words(), j, a.word(i));
    if (j < b.size() && b.word(j) == a.word(i)) {
      if (v != 0.0 && b.weight(j) != 0.0) sum += v * std::log(v / b.weight(j));
    } else if (v != 0.0) {
      sum += v * (std::log(v) - log_epsilon);
    }
  }
  return sum;
}

double bhattacharyya_score(const BowVector& a, const BowVector& b) {
  double sum = 0.0;
  for_each_common(a, b, [&sum](double v, double w) { sum += std::sqrt(v * w); });
  return sum;
}

double dot_product_score(const BowVector& a, const BowVector& b) {
  double sum = 0.0;
  for_each_common(a, b, [&sum](double v, double w) { sum += v * w; });
  return sum;
}

double score(Scoring scoring, const BowVector& a, const BowVector& b) {
  switch (scoring) {
    case Scoring::kL1:
      return l1_score(a, b);
    case Scoring::kL2:
      return l2_score(a, b);
    case Scoring::kChiSquare:
      return chi_square_score(a, b);
    case Scoring::kKullbackLeibler:
      return kullback_leibler_score(a, b);
    case Scoring::kBhattacharyya:
      return bhattacharyya_score(a, b);
    case Scoring::kDotProduct:
      return dot_product_score(a, b);
  }
  throw_invalid_argument("score", "scoring", static_cast<int>(scoring), "0 .. 5");
}

}  // namespace dynslam::loop
