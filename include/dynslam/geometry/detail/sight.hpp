// What references say of a point, and the sum of it.
#pragma once

#include <algorithm>

#include "dynslam/geometry/verdict.hpp"

namespace dynslam::geometry::detail {

/// What one reference says of a point.
enum class Sight { kOutside, kHole, kEdge, kHidden, kSeen, kMover, kThrough };

/// The numbers come first so that they travel in one register: split, each look-up waits for what
/// it has just stored.
struct SightResult {
  float excess;  ///< kThrough: how far in front, in margins beyond the margin
  float gap;     ///< metres between the point and what the reference saw
  Sight sight;

  SightResult(Sight sight_ = Sight::kOutside, float excess_ = 0.0F, float gap_ = 0.0F)
      : excess(excess_), gap(gap_), sight(sight_) {}
};

/// Share of a static vote that agreement with a former mover is worth.
inline constexpr float kMoverShare = 0.5F;

/// No votes are log-odds of 0.
inline Verdict verdict_of(float log_odds, float decision) {
  if (log_odds > decision) return Verdict::kDynamic;
  return log_odds < -decision ? Verdict::kStatic : Verdict::kUnknown;
}

/// Votes of the references about one point, added up.
struct SightTally {
  float log_odds = 0.0F;
  float gap = 0.0F;
  int through = 0, seen = 0, hidden = 0, edge = 0, hole = 0;

  void add(const SightResult& result, float dynamic_evidence, float static_evidence) {
    if (result.sight == Sight::kSeen) {  // by far the most frequent
      ++seen;
      gap += result.gap;
      log_odds -= static_evidence;
    } else if (result.sight == Sight::kHidden) {
      ++hidden;
    } else if (result.sight == Sight::kThrough) {
      ++through;
      gap += result.gap;
      log_odds += dynamic_evidence * std::min(1.0F, 0.5F + 0.5F * result.excess);
    } else if (result.sight == Sight::kMover) {
      ++seen;
      log_odds -= kMoverShare * static_evidence;
    } else if (result.sight == Sight::kEdge) {
      ++edge;
    } else if (result.sight == Sight::kHole) {
      ++hole;
    }
  }
  Verdict verdict(float decision) const { return verdict_of(log_odds, decision); }
  Reason reason(Verdict verdict) const {
    if (verdict == Verdict::kDynamic) return Reason::kFreeSpaceViolated;
    if (verdict == Verdict::kStatic) return Reason::kConsistent;
    if (through + seen > 0) return Reason::kUndecided;
    if (hidden > 0) return Reason::kOccluded;
    if (edge > 0) return Reason::kDepthEdge;
    return hole > 0 ? Reason::kNoDepth : Reason::kNoReference;
  }
};

}  // namespace dynslam::geometry::detail
