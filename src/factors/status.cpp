#include "dynslam/factors/pose_optimizer.hpp"

namespace dynslam::factors {

const char* to_string(SolveStatus status) {
  switch (status) {
    case SolveStatus::kConverged:
      return "Converged";
    case SolveStatus::kMaxIterations:
      return "MaxIterations";
    case SolveStatus::kTooFewPoints:
      return "TooFewPoints";
    case SolveStatus::kDegenerate:
      return "Degenerate";
    case SolveStatus::kNonFinite:
      return "NonFinite";
    case SolveStatus::kAborted:
      return "Aborted";
  }
  return "unknown";
}

}  // namespace dynslam::factors
