// What a Database consists of; shared by its sources.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <unordered_map>
#include <vector>

#include "dynslam/loop/database.hpp"

#include "posting_page.hpp"

namespace dynslam::loop {

/// Memory of one query.
struct QueryScratch {
  struct Term {
    float weight = 0.0F;  // of the query
    float bound = 0.0F;   // most that this word adds to any image
    float rest = 0.0F;    // most that this and all later words add
    PostingPage::List list;
    WordId word = 0;
  };
  std::vector<Term> terms;
  std::vector<float> gains;          // of each slot
  std::vector<float> order;          // for the k-th best
  std::vector<std::uint32_t> slots;  // images that may still be among the best
};

struct Database::State {
  State(std::size_t words_, Scoring scoring_)
      : words(words_),
        scoring(scoring_),
        pages((words_ + PostingPage::kWords - 1) / PostingPage::kWords) {}

  const std::size_t words;
  const Scoring scoring;

  // Images by slot, in the order of addition. A removed image keeps its slot until compaction.
  std::vector<std::uint64_t> ids;
  std::vector<float> scales;  // largest weight of the image
  std::vector<std::uint8_t> dead;
  std::unordered_map<std::uint64_t, std::uint32_t> slot_of;
  std::size_t dead_count = 0;
  float greatest_scale = 0.0F;  // of all images ever, for bounds
  std::vector<PostingPage> pages;

  // A writer holds the gate while it waits for the readers to leave, so that it is not starved by
  // readers that keep coming.
  mutable std::mutex gate;
  mutable std::shared_mutex guard;
  mutable std::mutex scratch_guard;
  mutable std::vector<std::unique_ptr<QueryScratch>> scratches;

  void check_bow(const char* function, const BowVector& bow) const;
  void append_postings(std::uint32_t slot, const BowVector& bow, float scale);
  void compact();

  /// Slots that images will have when the dead ones have left; those of dead images mean nothing.
  std::vector<std::uint32_t> slots_without_dead() const;
  PostingPage without_dead(const PostingPage& page, const std::vector<std::uint32_t>& moved) const;

  template <typename Sink>
  void write(Sink& sink) const;
  template <typename Source>
  static std::unique_ptr<State> read(Source& source);

  /// The scores that `gain` stands for; `base` is that of an image without a common word.
  double score_of(double gain, double base) const;
  double base_of(const BowVector& bow) const;
};

/// Holds readers' or the writer's lock.
class ReaderLock {
 public:
  ReaderLock(std::mutex& gate, std::shared_mutex& guard) {
    const std::lock_guard<std::mutex> turn(gate);
    lock_ = std::shared_lock<std::shared_mutex>(guard);
  }

 private:
  std::shared_lock<std::shared_mutex> lock_;
};

class WriterLock {
 public:
  WriterLock(std::mutex& gate, std::shared_mutex& guard) {
    const std::lock_guard<std::mutex> turn(gate);
    lock_ = std::unique_lock<std::shared_mutex>(guard);
  }

 private:
  std::unique_lock<std::shared_mutex> lock_;
};

}  // namespace dynslam::loop
