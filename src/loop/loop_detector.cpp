#include "dynslam/loop/loop_detector.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>
#include <unordered_set>
#include <utility>

#include "dynslam/core/errors.hpp"

namespace dynslam::loop {
namespace {

LoopReason reason_of(Verdict verdict) {
  switch (verdict) {
    case Verdict::kVerified:
      return LoopReason::kLoop;
    case Verdict::kFewMatches:
      return LoopReason::kFewMatches;
    case Verdict::kNoGeometry:
      return LoopReason::kNoGeometry;
    case Verdict::kOtherScene:
      return LoopReason::kOtherScene;
    case Verdict::kRefused:
      break;
  }
  return LoopReason::kRefusedByHost;
}

void finish_island(LoopIsland& island) {
  std::stable_sort(
      island.members.begin(), island.members.end(),
      [](const LoopCandidate& a, const LoopCandidate& b) { return a.score > b.score; });
  for (const LoopCandidate& member : island.members) island.score += member.normalized;
}

}  // namespace

std::string_view to_string(LoopReason reason) {
  switch (reason) {
    case LoopReason::kLoop:
      return "Loop";
    case LoopReason::kEmptyQuery:
      return "EmptyQuery";
    case LoopReason::kTooFewPlaces:
      return "TooFewPlaces";
    case LoopReason::kNoSharedWord:
      return "NoSharedWord";
    case LoopReason::kWeakNeighbour:
      return "WeakNeighbour";
    case LoopReason::kLowScore:
      return "LowScore";
    case LoopReason::kInconsistent:
      return "Inconsistent";
    case LoopReason::kFewMatches:
      return "FewMatches";
    case LoopReason::kNoGeometry:
      return "NoGeometry";
    case LoopReason::kOtherScene:
      return "OtherScene";
    case LoopReason::kStillInView:
      return "StillInView";
    case LoopReason::kRefusedByHost:
      return "RefusedByHost";
  }
  return "unknown";
}

void LoopDetectorOptions::validate() const {
  constexpr const char* kName = "LoopDetectorOptions";
  require(min_places >= 1, kName, "min_places", min_places, "at least 1");
  require(min_normalizer >= 0.0 && min_normalizer < 1.0, kName, "min_normalizer", min_normalizer,
          "a number in [0, 1)");
  require(min_score >= 0.0 && min_score <= 10.0, kName, "min_score", min_score,
          "a number in [0, 10]");
  require(max_candidates >= 1, kName, "max_candidates", max_candidates, "at least 1");
  require(consistency >= 1, kName, "consistency", consistency, "at least 1");
  require(max_missed >= 0, kName, "max_missed", max_missed, "at least 0");
  require(max_islands >= 1, kName, "max_islands", max_islands, "at least 1");
  require(max_verified >= 1, kName, "max_verified", max_verified, "at least 1");
  require(lone_confidence == 0.0 || (std::isfinite(lone_confidence) && lone_confidence >= 1.0),
          kName, "lone_confidence", lone_confidence, "0 or a number >= 1");
}

LoopDetector::LoopDetector(Database database, const LoopDetectorOptions& options,
                           NeighboursOf neighbours)
    : database_(std::move(database)), options_(options), neighbours_(std::move(neighbours)) {
  options_.validate();
  require(higher_is_better(database_.scoring()), "LoopDetector", "database's scoring",
          std::string_view("kKullbackLeibler"), "a scoring of which higher scores are better");
  require(options_.grouping != Grouping::kCovisibility || neighbours_ != nullptr, "LoopDetector",
          "neighbours", std::string_view("none"), "a callable, for Grouping::kCovisibility");
  for (const std::uint64_t id : database_.ids()) note(id);
}

void LoopDetector::note(std::uint64_t id) {
  order_.emplace(id, sequence_.size());
  sequence_.push_back(id);
  if (options_.exclude_recent == 0) return;
  recent_.push_back(id);
  if (recent_.size() > options_.exclude_recent) recent_.pop_front();
}

void LoopDetector::add(std::uint64_t id, const BowVector& bow) {
  database_.add(id, bow);
  note(id);
}

bool LoopDetector::remove(std::uint64_t id) {
  if (!database_.remove(id)) return false;
  order_.erase(id);
  const auto found = std::find(recent_.begin(), recent_.end(), id);
  if (found != recent_.end()) recent_.erase(found);
  return true;
}

void LoopDetector::forget_queries() {
  previous_.clear();
  runs_.clear();
}

std::vector<std::uint64_t> LoopDetector::excluded(const LoopQuery& query) const {
  std::vector<std::uint64_t> ids(recent_.begin(), recent_.end());
  ids.push_back(query.id);
  for (const std::uint64_t id : query.covisible) ids.push_back(id);
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  ids.erase(std::remove_if(ids.begin(), ids.end(),
                           [&](std::uint64_t id) { return order_.count(id) == 0; }),
            ids.end());
  return ids;
}

double LoopDetector::normalizer(const LoopQuery& query) const {
  if (options_.normalization == Normalization::kNone) return 1.0;
  if (options_.normalization != Normalization::kPreviousQuery) {
    std::vector<double> scores(query.covisible.size());
    database_.scores(*query.bow, query.covisible, scores);
    for (std::size_t i = 0; i < scores.size(); ++i) {
      if (query.covisible[i] == query.id) scores[i] = std::nan("");
    }
    scores.erase(std::remove_if(scores.begin(), scores.end(),
                                [](double value) { return std::isnan(value); }),
                 scores.end());
    const bool median = options_.normalization == Normalization::kMedianCovisible;
    const auto at = scores.begin() + static_cast<std::ptrdiff_t>(median ? scores.size() / 2 : 0);
    if (!scores.empty()) {
      std::nth_element(scores.begin(), at, scores.end());
      return *at;
    }
  }
  return score(database_.scoring(), *query.bow, previous_);
}

std::vector<LoopIsland> LoopDetector::islands(std::vector<LoopCandidate> candidates) const {
  std::vector<LoopIsland> islands;
  if (options_.grouping == Grouping::kOrder) {
    const auto order = [&](const LoopCandidate& c) { return order_.at(c.id); };
    std::sort(candidates.begin(), candidates.end(),
              [&](const LoopCandidate& a, const LoopCandidate& b) { return order(a) < order(b); });
    for (const LoopCandidate& candidate : candidates) {
      if (islands.empty() || order(candidate) - order(islands.back().members.back()) >
                                 std::uint64_t{options_.island_gap})
        islands.emplace_back();
      islands.back().members.push_back(candidate);
    }
  } else {
    // Best first: a candidate that is no neighbour of a better one founds an island.
    std::vector<std::uint8_t> taken(candidates.size(), 0);
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      if (taken[i] != 0) continue;
      const std::vector<std::uint64_t> around = neighbours_(candidates[i].id);
      const std::unordered_set<std::uint64_t> set(around.begin(), around.end());
      islands.emplace_back();
      for (std::size_t j = i; j < candidates.size(); ++j) {
        if (taken[j] != 0 || (j != i && set.count(candidates[j].id) == 0)) continue;
        taken[j] = 1;
        islands.back().members.push_back(candidates[j]);
      }
    }
  }
  for (LoopIsland& island : islands) finish_island(island);
  std::stable_sort(islands.begin(), islands.end(),
                   [](const LoopIsland& a, const LoopIsland& b) { return a.score > b.score; });
  return islands;
}

std::vector<std::uint64_t> LoopDetector::group_of(const LoopIsland& island) const {
  std::vector<std::uint64_t> group;
  if (options_.grouping == Grouping::kOrder) {
    std::uint64_t first = order_.at(island.members.front().id), last = first;
    for (const LoopCandidate& member : island.members) {
      first = std::min(first, order_.at(member.id));
      last = std::max(last, order_.at(member.id));
    }
    return {first, last};
  }
  group = neighbours_(island.members.front().id);
  for (const LoopCandidate& member : island.members) group.push_back(member.id);
  std::sort(group.begin(), group.end());
  group.erase(std::unique(group.begin(), group.end()), group.end());
  return group;
}

bool LoopDetector::same_place(const std::vector<std::uint64_t>& a,
                              const std::vector<std::uint64_t>& b) const {
  if (options_.grouping == Grouping::kOrder) {
    const std::uint64_t first = std::max(a[0], b[0]), last = std::min(a[1], b[1]);
    return first <= last || first - last <= std::uint64_t{options_.consistency_gap};
  }
  auto i = a.begin();
  auto j = b.begin();
  while (i != a.end() && j != b.end()) {
    if (*i == *j) return true;
    *i < *j ? ++i : ++j;
  }
  return false;
}

std::vector<LoopDetector::Run> LoopDetector::continue_runs(std::vector<LoopIsland>& islands) const {
  std::vector<Run> runs;
  std::vector<std::uint8_t> continued(runs_.size(), 0);
  for (LoopIsland& island : islands) {
    Run run;
    run.group = group_of(island);
    for (std::size_t r = 0; r < runs_.size(); ++r) {
      if (!same_place(runs_[r].group, run.group)) continue;
      continued[r] = 1;
      run.length = std::max(run.length, runs_[r].length + 1);
    }
    island.consistent = run.length;
    runs.push_back(std::move(run));
  }
  for (std::size_t r = 0; r < runs_.size(); ++r) {
    if (continued[r] != 0 || runs_[r].missed >= options_.max_missed) continue;
    runs.push_back(runs_[r]);
    ++runs.back().missed;
  }
  return runs;
}

bool LoopDetector::verify_island(const LoopQuery& query, const VerifyLoop& verify,
                                 const LoopIsland& island, LoopResult& result) const {
  const bool consistent = island.consistent >= options_.consistency;
  const std::size_t members = std::min(options_.max_verified, island.members.size());
  bool found = false;
  for (std::size_t m = 0; m < members; ++m) {
    const Verification verification = verify(query.id, island.members[m].id);
    ++result.verified;
    LoopReason reason = reason_of(verification.verdict);
    if (reason == LoopReason::kLoop && !consistent &&
        verification.confidence < options_.lone_confidence)
      reason = LoopReason::kInconsistent;
    const bool passed = reason == LoopReason::kLoop;
    const bool more = verification.inliers > result.verification.inliers;
    // Of the refused ones, too, the candidate with the most inliers is the one to tell about.
    if (result.verified == 1 || (passed && !found) || (passed == found && more)) {
      result.match = island.members[m].id;
      result.verification = verification;
      result.reason = reason;
    }
    found = found || passed;
  }
  return found;
}

bool LoopDetector::was_elsewhere(const LoopQuery& query, const VerifyLoop& verify,
                                 LoopResult& result) const {
  if (options_.probes == 0 || !query.covisible.empty()) return true;
  const std::size_t first = order_.at(result.match) + 1, end = sequence_.size();
  const auto shows_query = [&](std::size_t order) {
    const std::uint64_t id = sequence_[order];
    if (id == query.id || order_.count(id) == 0) return false;
    ++result.verified;
    return verify(query.id, id).verdict == Verdict::kVerified;
  };
  if (end < first + 3) return false;
  for (std::size_t p = 0; p < options_.probes; ++p) {
    // The middle of the p-th of equal parts, with a neighbour on both sides.
    const std::size_t at =
        std::clamp(first + (2 * p + 1) * (end - first) / (2 * options_.probes), first + 1, end - 2);
    if (!shows_query(at) && !shows_query(at - 1) && !shows_query(at + 1)) return true;
  }
  return false;
}

void LoopDetector::verify_islands(const LoopQuery& query, const VerifyLoop& verify,
                                  LoopResult& result) const {
  result.reason = LoopReason::kInconsistent;
  std::size_t tried = 0;
  for (const LoopIsland& island : result.islands) {
    const bool consistent = island.consistent >= options_.consistency;
    if (!consistent && (options_.lone_confidence == 0.0 || !verify)) continue;
    if (!verify) {
      result.reason = LoopReason::kLoop;
      result.match = island.members.front().id;
      return;
    }
    if (tried++ == options_.max_islands) return;
    if (!verify_island(query, verify, island, result)) continue;
    if (was_elsewhere(query, verify, result)) return;
    result.reason = LoopReason::kStillInView;
  }
}

LoopResult LoopDetector::detect(const LoopQuery& query, const VerifyLoop& verify) {
  require(query.bow != nullptr, "LoopDetector::detect", "query.bow", std::string_view("null"),
          "a vector");
  LoopResult result;
  result.query = query.id;
  const std::vector<std::uint64_t> skip = excluded(query);
  std::vector<LoopCandidate> candidates;
  if (query.bow->empty()) {
    result.reason = LoopReason::kEmptyQuery;
  } else if (order_.size() - skip.size() < options_.min_places) {
    result.reason = LoopReason::kTooFewPlaces;
  } else {
    result.reason = find_candidates(query, skip, candidates, result);
  }
  result.candidates = candidates.size();
  result.islands = islands(std::move(candidates));
  std::vector<Run> runs = continue_runs(result.islands);
  if (!result.islands.empty()) verify_islands(query, verify, result);

  runs_ = std::move(runs);
  if (!query.bow->empty()) previous_ = *query.bow;
  return result;
}

LoopReason LoopDetector::find_candidates(const LoopQuery& query,
                                         const std::vector<std::uint64_t>& skip,
                                         std::vector<LoopCandidate>& candidates,
                                         LoopResult& result) const {
  QueryOptions options;
  options.max_results = options_.max_candidates;
  options.excluded = skip;
  const std::vector<QueryResult> found = database_.query(*query.bow, options);
  if (found.empty()) return LoopReason::kNoSharedWord;
  result.match = found[0].id;
  result.has_match = true;
  result.best_score = found[0].score;
  result.normalizer = normalizer(query);
  if (!(result.normalizer > 0.0) || result.normalizer < options_.min_normalizer)
    return LoopReason::kWeakNeighbour;
  result.best_normalized = result.best_score / result.normalizer;
  for (const QueryResult& hit : found) {
    LoopCandidate candidate;
    candidate.id = hit.id;
    candidate.score = hit.score;
    candidate.normalized = hit.score / result.normalizer;
    if (candidate.normalized >= options_.min_score) candidates.push_back(candidate);
  }
  return LoopReason::kLowScore;  // of those that there are not
}

}  // namespace dynslam::loop
