#include "dynslam/evaluation/loop_metrics.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "dynslam/core/errors.hpp"

namespace dynslam::evaluation {
namespace {

std::size_t count_true_rows(ImageView<const std::uint8_t> truth) {
  std::size_t count = 0;
  for (int q = 0; q < truth.height; ++q) {
    const std::uint8_t* row = truth.row(q);
    count += std::any_of(row, row + truth.width, [](std::uint8_t v) { return v != 0; });
  }
  return count;
}

void require_detection(ImageView<const std::uint8_t> truth, const LoopDetection& detection,
                       std::size_t index) {
  const std::string name = "detections[" + std::to_string(index) + "]";
  require(truth.contains(detection.match, detection.query), "score_loops", name,
          "query " + std::to_string(detection.query) + ", match " + std::to_string(detection.match),
          "a query below " + std::to_string(truth.height) + " and a match below " +
              std::to_string(truth.width));
  require(!std::isnan(detection.score), "score_loops", name + ".score", "NaN", "a number");
}

}  // namespace

LoopScores score_loops(ImageView<const std::uint8_t> truth, Span<const LoopDetection> detections) {
  require(!truth.empty(), "score_loops", "truth", "an empty matrix", "one row for each query");
  for (std::size_t i = 0; i < detections.size(); ++i) require_detection(truth, detections[i], i);
  LoopScores scores;
  scores.queries = static_cast<std::size_t>(truth.height);
  scores.loops_true = count_true_rows(truth);
  scores.detected = detections.size();
  std::vector<LoopDetection> sorted(detections.begin(), detections.end());
  std::stable_sort(
      sorted.begin(), sorted.end(),
      [](const LoopDetection& a, const LoopDetection& b) { return a.score > b.score; });

  std::vector<bool> found(scores.queries, false);
  std::size_t rows_found = 0;
  const auto share = [](std::size_t part, std::size_t whole) {
    return whole == 0 ? 1.0 : static_cast<double>(part) / static_cast<double>(whole);
  };
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    const auto q = static_cast<std::size_t>(sorted[i].query);
    if (truth(sorted[i].match, sorted[i].query) != 0) {
      ++scores.correct;
      if (!found[q]) ++rows_found;
      found[q] = true;
    }
    const bool group_ends = i + 1 == sorted.size() || sorted[i + 1].score != sorted[i].score;
    if (!group_ends) continue;
    const PrecisionRecall point{sorted[i].score, share(scores.correct, i + 1),
                                share(rows_found, scores.loops_true)};
    scores.curve.push_back(point);
    if (scores.correct == i + 1) scores.recall_at_full_precision = point.recall;
  }
  scores.precision = share(scores.correct, scores.detected);
  scores.recall = share(rows_found, scores.loops_true);
  return scores;
}

}  // namespace dynslam::evaluation
