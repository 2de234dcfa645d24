// Runs a loop detector over images and scores what it found.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "dynslam/evaluation/loop_metrics.hpp"
#include "dynslam/loop/loop_detector.hpp"

namespace dynslam::cli {

struct LoopsOptions {
  std::vector<std::string> images;
  std::string truth, tum, vocabulary, detections;
  int features = 1000;
  std::size_t exclude_recent = 20;
  bool no_geometry = false;
};

struct LoopsOutcome {
  evaluation::LoopScores scores;
  std::size_t unjudged = 0;  ///< detections of which the truth does not say what they are
  std::array<std::size_t, loop::kLoopReasons> reasons = {};
  std::vector<double> ms;           ///< of each image: words, query, verification, storing
  std::vector<double> extract_ms;   ///< of each image: features
  std::vector<double> pose_errors;  ///< of each loop, metres, where true poses are known
  std::size_t words = 0;
  std::string vocabulary;  ///< where it came from
};

/// Throws InvalidArgument or IoError with one clear sentence.
LoopsOutcome run_loops(const LoopsOptions& options);

}  // namespace dynslam::cli
