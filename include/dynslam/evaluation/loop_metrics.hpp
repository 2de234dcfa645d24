// Scores of a loop detector against known loops.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "dynslam/core/image_view.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::evaluation {

/// A loop that a detector reports: image `query` shows the place of the earlier image `match`.
struct LoopDetection {
  int query = 0;
  int match = 0;
  double score = 0.0;  ///< higher is surer
};

/// Precision and recall when detections with a score of at least `threshold` are kept.
struct PrecisionRecall {
  double threshold = 0.0;
  double precision = 1.0;
  double recall = 0.0;
};

struct LoopScores {
  std::size_t queries = 0;     ///< rows of the truth
  std::size_t loops_true = 0;  ///< rows that have a true match
  std::size_t detected = 0;    ///< detections
  std::size_t correct = 0;     ///< detections that the truth confirms
  double precision = 1.0;      ///< correct / detected; 1 when nothing was detected
  double recall = 1.0;  ///< true rows with a correct detection / loops_true; 1 when there are none
  /// Largest recall of a threshold that lets no false detection through; 0 when there is none.
  double recall_at_full_precision = 0.0;
  std::vector<PrecisionRecall> curve;  ///< one point for each distinct score, thresholds falling
};

/// Scores detections against a truth matrix: row q, column r is not 0 when images q and r show the
/// same place.
///
/// Several detections of one query count one by one for precision and once for recall. Detections
/// of equal score are kept or dropped together. Throws InvalidArgument for an empty truth, a
/// detection outside of it, or a score that is NaN. O(pixels + d log d), allocates. Thread-safe.
LoopScores score_loops(ImageView<const std::uint8_t> truth, Span<const LoopDetection> detections);

}  // namespace dynslam::evaluation
