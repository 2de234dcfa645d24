#include "dynslam/factors/pose_optimizer.hpp"

namespace dynslam::factors {

const char* to_string(SolveStatus status) {
  switch (status) {
    case SolveStatus::Converged:
      return "Converged";
    case SolveStatus::MaxIterations:
      return "MaxIterations";
    case SolveStatus::TooFewPoints:
      return "TooFewPoints";
    case SolveStatus::Degenerate:
      return "Degenerate";
    case SolveStatus::NonFinite:
      return "NonFinite";
    case SolveStatus::Aborted:
      return "Aborted";
  }
  return "unknown";
}

}  // namespace dynslam::factors
