// Queries: gains of all images over the words of the query, and when to stop asking for new ones.
#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/database.hpp"

#include "database_state.hpp"

namespace dynslam::loop {
namespace {

using Term = QueryScratch::Term;

constexpr float kNever = -std::numeric_limits<float>::infinity();
const float kLogEpsilon = std::log(0x1p-52F);

// What a common word of weights q (query) and b (image) adds to a score, before the transform that
// score_of does. All are >= 0, rise with b and are 0 without the word.
struct L1Gain {
  float operator()(float q, float b) const { return std::min(q, b); }
};
struct ProductGain {
  float operator()(float q, float b) const { return q * b; }
};
struct ChiSquareGain {
  float operator()(float q, float b) const { return 2.0F * q * (b / (q + b)); }
};
struct BhattacharyyaGain {
  float operator()(float q, float b) const { return std::sqrt(q) * std::sqrt(b); }
};
struct KullbackLeiblerGain {  // q log(q / eps) - q log(q / b)
  float operator()(float q, float b) const {
    return std::max(0.0F, q * (std::log(b) - kLogEpsilon));
  }
};

// Adds the word's gains to all images.
template <typename Gain>
void add_all(const Term& term, const float* scales, float* gains, Gain gain) {
  const float q = term.weight;
  for_each_posting(term.list, [=](std::uint32_t slot, std::uint32_t code) {
    gains[slot] += gain(q, decode_ratio(code) * scales[slot]);
  });
}

// Adds the word's gains to some images, ascending, and skips the blocks that hold none of them.
template <typename Gain>
void add_some(const Term& term, const std::vector<std::uint32_t>& slots, const float* scales,
              float* gains, Gain gain) {
  constexpr std::uint32_t kBlock = PostingPage::kBlockBytes;
  const float q = term.weight;
  const std::uint32_t blocks = (term.list.bytes + kBlock - 1) / kBlock;
  std::size_t next = 0;
  std::uint32_t block = 0;
  while (next < slots.size() && block < blocks) {
    // The last block that starts at or before the next image, by growing steps.
    std::uint32_t step = 1, low = block;
    while (low + step < blocks &&
           first_slot(term.list.begin + (low + step) * kBlock) <= slots[next]) {
      low += step;
      step *= 2;
    }
    for (; step > 0; step /= 2) {
      if (low + step < blocks && first_slot(term.list.begin + (low + step) * kBlock) <= slots[next])
        low += step;
    }
    block = low;
    const std::uint32_t bytes = std::min(kBlock, term.list.bytes - block * kBlock);
    for_each_in_block(term.list.begin + block * kBlock, bytes,
                      [&](std::uint32_t slot, std::uint32_t code) {
                        while (next < slots.size() && slots[next] < slot) ++next;
                        if (next < slots.size() && slots[next] == slot)
                          gains[slot] += gain(q, decode_ratio(code) * scales[slot]);
                      });
    // What lies before the next block cannot be in a later one.
    ++block;
    if (block == blocks) break;
    const std::uint32_t following = first_slot(term.list.begin + block * kBlock);
    while (next < slots.size() && slots[next] < following) ++next;
  }
}

// The k-th greatest gain, or 0 if fewer images have any.
float kth_gain(const std::vector<float>& gains, std::size_t k, std::vector<float>& order) {
  order.clear();
  for (const float gain : gains) {
    if (gain > 0.0F) order.push_back(gain);
  }
  if (order.size() < k) return 0.0F;
  const auto kth = order.begin() + static_cast<std::ptrdiff_t>(k - 1);
  std::nth_element(order.begin(), kth, order.end(), std::greater<>());
  return *kth;
}

// Roundings of a sum of floats could let a bound fall below what it bounds.
constexpr float kSafety = 1.0001F;

/// Accumulates the gains of the terms, best bound first, so that at least the `k` best images, or
/// all with a gain of at least `least`, have theirs complete.
template <typename Gain>
void accumulate(QueryScratch& scratch, const float* scales, float greatest_scale, std::size_t k,
                float least, Gain gain) {
  for (Term& term : scratch.terms) term.bound = gain(term.weight, greatest_scale);
  std::sort(scratch.terms.begin(), scratch.terms.end(), [](const Term& a, const Term& b) {
    return a.bound > b.bound || (a.bound == b.bound && a.word < b.word);
  });
  float rest = 0.0F;
  for (auto term = scratch.terms.rbegin(); term != scratch.terms.rend(); ++term) {
    rest += term->bound;
    term->rest = rest * kSafety;
  }
  float* const gains = scratch.gains.data();
  const std::size_t images = scratch.gains.size();
  std::size_t bytes = 0, i = 0;
  const std::size_t count = scratch.terms.size();
  const bool may_stop = k > 0 || least > 0.0F;
  for (; i < count; ++i) {
    const Term& term = scratch.terms[i];
    // Asking for the k-th best costs a walk over the images: only after as much other work.
    if (may_stop && bytes > 8 * images) {
      bytes = 0;
      float enough = least;
      if (k > 0) enough = std::max(enough, kth_gain(scratch.gains, k, scratch.order));
      if (enough > term.rest) {
        for (std::size_t slot = 0; slot < images; ++slot) {
          if (gains[slot] + term.rest >= enough)
            scratch.slots.push_back(static_cast<std::uint32_t>(slot));
        }
        break;
      }
    }
    if (i + 8 < count) __builtin_prefetch(scratch.terms[i + 8].list.begin);
    bytes += term.list.bytes;
    add_all(term, scales, gains, gain);
  }
  for (; i < count; ++i) {
    const Term& term = scratch.terms[i];
    if (i + 8 < count) __builtin_prefetch(scratch.terms[i + 8].list.begin);
    if (term.list.bytes / PostingPage::kBlockBytes > 2 * scratch.slots.size()) {
      add_some(term, scratch.slots, scales, gains, gain);
    } else {
      add_all(term, scales, gains, gain);
    }
  }
}

void accumulate(Scoring scoring, QueryScratch& scratch, const float* scales, float greatest_scale,
                std::size_t k, float least) {
  switch (scoring) {
    case Scoring::kL1:
      return accumulate(scratch, scales, greatest_scale, k, least, L1Gain{});
    case Scoring::kL2:
    case Scoring::kDotProduct:
      return accumulate(scratch, scales, greatest_scale, k, least, ProductGain{});
    case Scoring::kChiSquare:
      return accumulate(scratch, scales, greatest_scale, k, least, ChiSquareGain{});
    case Scoring::kBhattacharyya:
      return accumulate(scratch, scales, greatest_scale, k, least, BhattacharyyaGain{});
    case Scoring::kKullbackLeibler:
      return accumulate(scratch, scales, greatest_scale, k, least, KullbackLeiblerGain{});
  }
}

}  // namespace

double Database::State::base_of(const BowVector& bow) const {
  if (scoring != Scoring::kKullbackLeibler) return 0.0;
  double base = 0.0;
  for (const double q : bow.weights()) {
    if (q > 0.0) base += q * (std::log(q) - std::log(0x1p-52));
  }
  return base;
}

double Database::State::score_of(double gain, double base) const {
  if (scoring == Scoring::kKullbackLeibler) return base - gain;
  if (scoring == Scoring::kL2) return 1.0 - std::sqrt(std::max(0.0, 1.0 - gain));
  return gain;
}

namespace {

/// Gain that an image of this score has, rounded down a little; 0 if every image has more.
float least_gain(Scoring scoring, double worst_score, double base) {
  double gain = worst_score;
  if (scoring == Scoring::kKullbackLeibler) gain = base - worst_score;
  if (scoring == Scoring::kL2) {
    const double rest = std::max(0.0, 1.0 - worst_score);
    gain = 1.0 - rest * rest;
    if (worst_score <= 0.0) gain = 0.0;
  }
  return static_cast<float>(std::clamp(gain * 0.9999, 0.0, 3e38));
}

class ScratchHolder {
 public:
  using Take = std::unique_ptr<QueryScratch>;
  ScratchHolder(std::mutex& guard, std::vector<Take>& pool) : guard_(guard), pool_(pool) {
    {
      const std::lock_guard<std::mutex> lock(guard_);
      if (!pool_.empty()) {
        scratch_ = std::move(pool_.back());
        pool_.pop_back();
      }
    }
    if (scratch_ == nullptr) scratch_ = std::make_unique<QueryScratch>();
  }
  ~ScratchHolder() {
    const std::lock_guard<std::mutex> lock(guard_);
    try {
      pool_.push_back(std::move(scratch_));
    } catch (const std::bad_alloc&) {
      // Then the next query makes itself another one.
    }
  }
  ScratchHolder(const ScratchHolder&) = delete;
  ScratchHolder& operator=(const ScratchHolder&) = delete;
  QueryScratch& operator*() const { return *scratch_; }

 private:
  std::mutex& guard_;
  std::vector<Take>& pool_;
  Take scratch_;
};

void find_lists(const BowVector& bow, const std::vector<PostingPage>& pages,
                std::vector<Term>& terms) {
  constexpr std::size_t kFar = 16, kNear = 8;
  terms.clear();
  const std::size_t n = bow.size();
  const auto page_of = [&](std::size_t i) -> const PostingPage& {
    return pages[bow.word(i) / PostingPage::kWords];
  };
  for (std::size_t i = 0; i < n; ++i) {
    if (i + kFar < n) __builtin_prefetch(&page_of(i + kFar));
    if (i + kNear < n)
      __builtin_prefetch(page_of(i + kNear).table_line(bow.word(i + kNear) % PostingPage::kWords));
    const auto weight = static_cast<float>(bow.weight(i));
    if (weight <= 0.0F) continue;
    const PostingPage::List list = page_of(i).list(bow.word(i) % PostingPage::kWords);
    if (list.bytes == 0) continue;
    __builtin_prefetch(list.begin);
    Term term;
    term.weight = weight;
    term.list = list;
    term.word = bow.word(i);
    terms.push_back(term);
  }
}

}  // namespace

void Database::query(const BowVector& bow, const QueryOptions& options,
                     std::vector<QueryResult>& results) const {
  const State& s = *state_;
  s.check_bow("Database::query", bow);
  require(!options.worst_score || !std::isnan(*options.worst_score), "Database::query",
          "worst_score", std::string_view("NaN"), std::string_view("a number"));
  const ScratchHolder holder(s.scratch_guard, s.scratches);
  QueryScratch& scratch = *holder;
  const ReaderLock lock(s.gate, s.guard);

  scratch.slots.clear();
  scratch.gains.assign(s.ids.size(), 0.0F);
  if (s.dead_count > 0) {
    for (std::size_t slot = 0; slot < s.ids.size(); ++slot) {
      if (s.dead[slot] != 0) scratch.gains[slot] = kNever;
    }
  }
  for (const std::uint64_t id : options.excluded) {
    const auto found = s.slot_of.find(id);
    if (found != s.slot_of.end()) scratch.gains[found->second] = kNever;
  }
  find_lists(bow, s.pages, scratch.terms);
  const double base = s.base_of(bow);
  const float least =
      options.worst_score ? least_gain(s.scoring, *options.worst_score, base) : 0.0F;
  accumulate(s.scoring, scratch, s.scales.data(), s.greatest_scale, options.max_results, least);

  float kth = 0.0F;
  if (options.max_results > 0) kth = kth_gain(scratch.gains, options.max_results, scratch.order);
  scratch.slots.clear();
  for (std::size_t slot = 0; slot < scratch.gains.size(); ++slot) {
    const float gain = scratch.gains[slot];
    if (gain > 0.0F && gain >= kth && gain >= least)
      scratch.slots.push_back(static_cast<std::uint32_t>(slot));
  }
  const std::vector<float>& gains = scratch.gains;
  std::sort(scratch.slots.begin(), scratch.slots.end(), [&](std::uint32_t a, std::uint32_t b) {
    return gains[a] > gains[b] || (gains[a] == gains[b] && a < b);
  });
  results.clear();
  for (const std::uint32_t slot : scratch.slots) {
    if (options.max_results > 0 && results.size() == options.max_results) break;
    const double score = s.score_of(gains[slot], base);
    if (options.worst_score &&
        (higher_is_better(s.scoring) ? score < *options.worst_score : score > *options.worst_score))
      continue;
    results.push_back({s.ids[slot], score});
  }
}

std::vector<QueryResult> Database::query(const BowVector& bow, const QueryOptions& options) const {
  std::vector<QueryResult> results;
  query(bow, options, results);
  return results;
}

void Database::scores(const BowVector& bow, Span<const std::uint64_t> ids,
                      Span<double> scores) const {
  const State& s = *state_;
  s.check_bow("Database::scores", bow);
  require(ids.size() == scores.size(), "Database::scores", "scores", scores.size(),
          "one for each of " + std::to_string(ids.size()) + " ids");
  const ScratchHolder holder(s.scratch_guard, s.scratches);
  QueryScratch& scratch = *holder;
  const ReaderLock lock(s.gate, s.guard);
  scratch.slots.clear();
  scratch.gains.assign(s.ids.size(), 0.0F);
  find_lists(bow, s.pages, scratch.terms);
  accumulate(s.scoring, scratch, s.scales.data(), s.greatest_scale, 0, 0.0F);
  const double base = s.base_of(bow);
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const auto found = s.slot_of.find(ids[i]);
    scores[i] =
        found == s.slot_of.end() ? std::nan("") : s.score_of(scratch.gains[found->second], base);
  }
}

}  // namespace dynslam::loop
