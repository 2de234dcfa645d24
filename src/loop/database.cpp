#include "dynslam/loop/database.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dynslam/core/errors.hpp"

#include "database_state.hpp"

namespace dynslam::loop {
namespace {

constexpr double kGreatestWeight = 3e38;  // a float still

}  // namespace

void Database::State::check_bow(const char* function, const BowVector& bow) const {
  if (!bow.empty()) {
    const WordId last = bow.word(bow.size() - 1);
    require(last < words, function, "word", last, "a word below " + std::to_string(words));
  }
  for (const double weight : bow.weights()) {
    require(weight >= 0.0 && weight <= kGreatestWeight, function, "weight", weight,
            "a number in [0, 3e38]");
  }
}

void Database::State::append_postings(std::uint32_t slot, const BowVector& bow, float scale) {
  if (scale <= 0.0F) return;
  for (std::size_t i = 0; i < bow.size(); ++i) {
    const auto weight = static_cast<float>(bow.weight(i));
    if (weight <= 0.0F) continue;
    const WordId word = bow.word(i);
    pages[word / PostingPage::kWords].append(word % PostingPage::kWords, slot,
                                             encode_ratio(weight / scale));
  }
}

std::vector<std::uint32_t> Database::State::slots_without_dead() const {
  std::vector<std::uint32_t> moved(ids.size());
  std::uint32_t next = 0;
  for (std::size_t slot = 0; slot < ids.size(); ++slot) {
    moved[slot] = next;
    next += dead[slot] == 0 ? 1U : 0U;
  }
  return moved;
}

PostingPage Database::State::without_dead(const PostingPage& page,
                                          const std::vector<std::uint32_t>& moved) const {
  PostingPage fresh;
  for (std::uint32_t word = 0; word < PostingPage::kWords; ++word) {
    for_each_posting(page.list(word), [&](std::uint32_t slot, std::uint32_t code) {
      if (dead[slot] == 0) fresh.append(word, moved[slot], code);
    });
  }
  return fresh;
}

void Database::State::compact() {
  if (dead_count == 0) return;
  const std::vector<std::uint32_t> moved = slots_without_dead();
  for (PostingPage& page : pages) {
    if (!page.empty()) page = without_dead(page, moved);
  }
  std::vector<std::uint64_t> live_ids;
  std::vector<float> live_scales;
  greatest_scale = 0.0F;
  for (std::size_t slot = 0; slot < ids.size(); ++slot) {
    if (dead[slot] != 0) continue;
    slot_of[ids[slot]] = moved[slot];
    live_ids.push_back(ids[slot]);
    live_scales.push_back(scales[slot]);
    greatest_scale = std::max(greatest_scale, scales[slot]);
  }
  ids = std::move(live_ids);
  scales = std::move(live_scales);
  dead.assign(ids.size(), 0);
  dead_count = 0;
}

Database::Database(std::size_t words, Scoring scoring) {
  require(words >= 1 && words <= 0xFFFFFFFFULL, "Database", "words", words,
          "a number of words in [1, 2^32)");
  state_ = std::make_unique<State>(words, scoring);
}

Database::Database(std::unique_ptr<State> state) : state_(std::move(state)) {}
Database::~Database() = default;
Database::Database(Database&&) noexcept = default;
Database& Database::operator=(Database&&) noexcept = default;

void Database::add(std::uint64_t id, const BowVector& bow) {
  State& s = *state_;
  s.check_bow("Database::add", bow);
  double greatest = 0.0;
  for (const double weight : bow.weights()) greatest = std::max(greatest, weight);
  const auto scale = static_cast<float>(greatest);

  const WriterLock lock(s.gate, s.guard);
  require(s.slot_of.count(id) == 0, "Database::add", "id", id, "an id that is not stored yet");
  require(s.ids.size() < 0xFFFFFFFEULL, "Database::add", "images", s.ids.size(),
          "fewer than 2^32 - 2 images");
  const auto slot = static_cast<std::uint32_t>(s.ids.size());
  s.ids.push_back(id);
  s.scales.push_back(scale);
  s.dead.push_back(0);
  s.slot_of.emplace(id, slot);
  s.greatest_scale = std::max(s.greatest_scale, scale);
  s.append_postings(slot, bow, scale);
}

bool Database::remove(std::uint64_t id) {
  State& s = *state_;
  const WriterLock lock(s.gate, s.guard);
  const auto found = s.slot_of.find(id);
  if (found == s.slot_of.end()) return false;
  s.dead[found->second] = 1;
  ++s.dead_count;
  s.slot_of.erase(found);
  constexpr std::size_t kFewEnough = 32;  // not worth the walk over all pages
  if (s.dead_count > kFewEnough && 3 * s.dead_count > s.ids.size()) s.compact();
  return true;
}

void Database::clear() {
  State& s = *state_;
  const WriterLock lock(s.gate, s.guard);
  s.ids.clear();
  s.scales.clear();
  s.dead.clear();
  s.slot_of.clear();
  s.dead_count = 0;
  s.greatest_scale = 0.0F;
  for (PostingPage& page : s.pages) page = {};
}

void Database::compact() {
  const WriterLock lock(state_->gate, state_->guard);
  state_->compact();
}

bool Database::contains(std::uint64_t id) const {
  const ReaderLock lock(state_->gate, state_->guard);
  return state_->slot_of.count(id) != 0;
}

std::size_t Database::size() const {
  const ReaderLock lock(state_->gate, state_->guard);
  return state_->slot_of.size();
}

std::vector<std::uint64_t> Database::ids() const {
  const State& s = *state_;
  const ReaderLock lock(s.gate, s.guard);
  std::vector<std::uint64_t> result;
  result.reserve(s.slot_of.size());
  for (std::size_t slot = 0; slot < s.ids.size(); ++slot) {
    if (s.dead[slot] == 0) result.push_back(s.ids[slot]);
  }
  return result;
}

std::size_t Database::words() const { return state_->words; }
Scoring Database::scoring() const { return state_->scoring; }

std::size_t Database::bytes() const {
  const State& s = *state_;
  const ReaderLock lock(s.gate, s.guard);
  std::size_t total = sizeof(State) + s.pages.capacity() * sizeof(PostingPage) +
                      s.ids.capacity() * sizeof(s.ids[0]) + s.scales.capacity() * sizeof(float) +
                      s.dead.capacity();
  constexpr std::size_t kNode = 32;  // a node of the hash table with its allocation
  total += s.slot_of.size() * kNode + s.slot_of.bucket_count() * sizeof(void*);
  for (const PostingPage& page : s.pages) total += page.allocated();
  return total;
}

}  // namespace dynslam::loop
