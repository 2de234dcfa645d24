// The same images in dynslam's and DBoW2's database, by turns; see rivals_database.sh. No part of
// the build.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include <DBoW2.h>
#include <FORB.h>
#include <TemplatedDatabase.h>
#include <TemplatedVocabulary.h>
#include <malloc.h>

#include "dynslam/loop/database.hpp"

#include "database_images.hpp"

using Clock = std::chrono::steady_clock;
using namespace dynslam::loop;

static double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// The database asks a vocabulary for no more than its number of words and its scoring.
class FlatVocabulary : public DBoW2::TemplatedVocabulary<DBoW2::FORB::TDescriptor, DBoW2::FORB> {
 public:
  unsigned int size() const override { return benchmark_data::kDatabaseWords; }
};
using Rival = DBoW2::TemplatedDatabase<DBoW2::FORB::TDescriptor, DBoW2::FORB>;

static double heap_mb() {
  return static_cast<double>(mallinfo2().uordblks + mallinfo2().hblkhd) * 1e-6;
}

static double median(std::vector<double> ms) {
  std::nth_element(ms.begin(), ms.begin() + static_cast<std::ptrdiff_t>(ms.size() / 2), ms.end());
  return ms[ms.size() / 2];
}

int main() {
  using benchmark_data::kDatabaseWords;
  double before = heap_mb();
  Rival rival(FlatVocabulary(), false);
  std::printf("DBoW2, empty: %.1f MB of heap\n", heap_mb() - before);
  double ours_mb = 0.0, rival_mb = 0.0;
  Database ours(kDatabaseWords);
  std::vector<double> ours_add, rival_add;
  std::size_t stored = 0;
  for (const std::size_t images : {1000U, 10000U}) {
    for (; stored < images; ++stored) {
      const BowVector bow = benchmark_data::walk_image(stored);
      DBoW2::BowVector map;
      for (std::size_t i = 0; i < bow.size(); ++i) map.addWeight(bow.word(i), bow.weight(i));
      before = heap_mb();
      auto start = Clock::now();
      ours.add(stored, bow);
      ours_add.push_back(ms_since(start));
      const double between = heap_mb();
      start = Clock::now();
      rival.add(map);
      rival_add.push_back(ms_since(start));
      ours_mb += between - before;
      rival_mb += heap_mb() - between;
    }
    std::vector<double> ours_ms, all_ms, rival_ms;
    bool same = true;
    for (std::size_t q = 0; q < 60; ++q) {
      // Between two stored images: shares a quarter of its features with both.
      const BowVector bow = benchmark_data::walk_image((q * 7919) % images);
      DBoW2::BowVector map;
      for (std::size_t i = 0; i < bow.size(); ++i) map.addWeight(bow.word(i), bow.weight(i));
      std::vector<QueryResult> results, all;
      QueryOptions ten, every;
      every.max_results = 0;
      DBoW2::QueryResults expected;
      auto start = Clock::now();
      ours.query(bow, ten, results);
      ours_ms.push_back(ms_since(start));
      start = Clock::now();
      rival.query(map, expected, 10);
      rival_ms.push_back(ms_since(start));
      start = Clock::now();
      ours.query(bow, every, all);
      all_ms.push_back(ms_since(start));
      for (std::size_t i = 0; i < 3; ++i) {
        same = same && results[i].id == expected[i].Id &&
               std::abs(results[i].score - expected[i].Score) < 5e-4 * expected[i].Score;
      }
    }
    std::printf(
        "%zu images: query for 10 %.3f ms, for all %.3f ms, DBoW2 for 10 %.2f ms; ratio %.4f; best "
        "three agree: %s\n",
        images, median(ours_ms), median(all_ms), median(rival_ms),
        median(ours_ms) / median(rival_ms), same ? "yes" : "NO");
    std::printf(
        "  add: %.3f ms, DBoW2 %.3f ms; heap: dynslam %.1f MB (bytes() %.1f MB), DBoW2 %.1f MB\n",
        median(ours_add), median(rival_add), ours_mb + 1e-6 * double(8 * kDatabaseWords / 64),
        1e-6 * static_cast<double>(ours.bytes()), rival_mb);
  }
}
