// Loop detector: has this place been seen before, and if not, why is it thought so?
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/loop/bow_vector.hpp"
#include "dynslam/loop/database.hpp"
#include "dynslam/loop/verification.hpp"

namespace dynslam::loop {

/// How a query ended. Everything but kLoop is a refusal; the order is that of the tests.
enum class LoopReason : std::uint8_t {
  kLoop = 0,       ///< a loop, all tests passed
  kEmptyQuery,     ///< the query has no words: dark, blurred, or masked out
  kTooFewPlaces,   ///< fewer images are stored, beside the excluded ones, than min_places
  kNoSharedWord,   ///< no stored image has a word in common with the query
  kWeakNeighbour,  ///< the query is unlike its own neighbours, scores mean nothing
  kLowScore,       ///< the best normalized score is below min_score
  kInconsistent,   ///< not enough queries in a row point to this place
  kFewMatches,     ///< geometric verification found too few matches
  kNoGeometry,     ///< no motion explains enough of the matches
  kOtherScene,     ///< a motion explains an object, not the scene
  kStillInView,    ///< verified, but the camera has not looked elsewhere in between
  kRefusedByHost   ///< the host's verification said no without a reason
};
inline constexpr std::size_t kLoopReasons = 12;

/// "Loop", "EmptyQuery", ...: the enumerator's name without its k.
std::string_view to_string(LoopReason reason);

/// What scores are divided by, so that one threshold serves all scenes: the best score that can be
/// expected of the same place.
enum class Normalization : std::uint8_t {
  kNone,            ///< 1
  kPreviousQuery,   ///< score against the query before (Galvez-Lopez & Tardos 2012)
  kLeastCovisible,  ///< lowest score against the covisible images (Mur-Artal et al. 2015); against
                    ///< the query before if there are none
  kMedianCovisible  ///< median of the scores against the covisible images, likewise: asks less of
                    ///< where covisibility begins, and nothing of the rate of images (engineering)
};

/// How islands and consistency tell who belongs together.
enum class Grouping : std::uint8_t {
  kOrder,        ///< images added shortly after one another
  kCovisibility  ///< images that the host's callable names as neighbours
};

/// Settings of a LoopDetector.
struct LoopDetectorOptions {
  Normalization normalization = Normalization::kMedianCovisible;
  Grouping grouping = Grouping::kOrder;
  /// The last images added are no candidates: they show the place because the camera has not left
  /// it. Images, >= 0. Hosts that know covisible images name those instead. Engineering: 20
  /// (Galvez- Lopez & Tardos leave out 20 s at one image a second).
  std::size_t exclude_recent = 20;
  /// Fewest images beside the excluded ones. >= 1.
  std::size_t min_places = 1;
  /// Normalizers below this say that the query is unlike even its neighbours. In [0, 1); 0 switches
  /// the test off. Source: 0.005, Galvez-Lopez & Tardos 2012.
  double min_normalizer = 0.005;
  /// Lowest score over normalizer of a candidate. In [0, 10]. Source: alpha = 0.3, Galvez-Lopez &
  /// Tardos 2012.
  double min_score = 0.3;
  /// Most candidates taken from the database. >= 1. Source: 50, Galvez-Lopez & Tardos 2012.
  std::size_t max_candidates = 50;
  /// Candidates whose orders of addition differ by up to this form an island. Images, >= 0; only
  /// with Grouping::kOrder. Source: 3, Galvez-Lopez & Tardos 2012.
  std::size_t island_gap = 3;
  /// Queries in a row, this one included, whose islands must lie at the same place. >= 1; 1
  /// switches the test off. Source: 3, Mur-Artal et al. 2015 and Galvez-Lopez & Tardos 2012.
  int consistency = 3;
  /// With Grouping::kOrder: how far an island may lie from the one of the query before, counted
  /// between the ends nearest to each other. Images, >= 0. Source: 3, Galvez-Lopez & Tardos 2012.
  std::size_t consistency_gap = 3;
  /// Queries without the island that a run may bridge. >= 0.
  int max_missed = 1;
  /// Islands that are verified, best first, until one passes. >= 1.
  std::size_t max_islands = 3;
  /// Candidates of an island that are verified, best first; the one with the most inliers is the
  /// match. >= 1.
  std::size_t max_verified = 5;
  /// Where nobody names covisible images: a verified match is no loop if the query verifies against
  /// all images in between, of which so many, evenly spaced, are tried. Where one fails its two
  /// neighbours must fail, too, to show that the camera was elsewhere. >= 0; 0 switches the test
  /// off, and so does a query with covisible images. Engineering.
  std::size_t probes = 8;
  /// A candidate whose verification is at least this many times as significant as asked for
  /// (Verification::confidence) needs no consistency; 0: all need it. 0 or >= 1.
  double lone_confidence = 0.0;

  /// Throws InvalidArgument naming the first member that breaks its rule.
  void validate() const;
};

/// An image to look for.
struct LoopQuery {
  std::uint64_t id = 0;  ///< for `verify`; need not be stored
  const BowVector* bow = nullptr;
  /// Images that see the same things now: no candidates; they make the normalizer.
  Span<const std::uint64_t> covisible;
};

/// A stored image on the way to be the loop.
struct LoopCandidate {
  std::uint64_t id = 0;
  double score = 0.0;       ///< raw
  double normalized = 0.0;  ///< score / normalizer
};

/// Candidates at one place, best first.
struct LoopIsland {
  std::vector<LoopCandidate> members;
  double score = 0.0;  ///< sum of the members' normalized scores
  int consistent = 1;  ///< queries in a row that pointed here, this one included
};

/// Answer to a query with everything that led there.
struct LoopResult {
  LoopReason reason = LoopReason::kEmptyQuery;
  std::uint64_t query = 0;
  /// The loop, or for a refusal the candidate that came farthest, if has_match.
  std::uint64_t match = 0;
  bool has_match = false;
  double normalizer = 0.0;          ///< 0 if it was not computed
  double best_score = 0.0;          ///< raw score of the best candidate
  double best_normalized = 0.0;     ///< the same over the normalizer
  std::size_t candidates = 0;       ///< candidates with a normalized score of at least min_score
  std::size_t verified = 0;         ///< calls of `verify`
  std::vector<LoopIsland> islands;  ///< best first
  Verification verification;        ///< of `match`, if it was verified

  explicit operator bool() const { return reason == LoopReason::kLoop; }
};

/// Verifies a candidate by geometry: (query, candidate) -> result. May throw; the exception goes
/// through `detect`, whose state stays as it was before.
using VerifyLoop = std::function<Verification(std::uint64_t query, std::uint64_t candidate)>;

/// Neighbours of a stored image in the covisibility graph. Ids not stored are allowed.
using NeighboursOf = std::function<std::vector<std::uint64_t>(std::uint64_t id)>;

/// Detects loops: query, normalization, islands, consistency, geometric verification.
///
/// For each keyframe call `detect` and then `add`; `remove` when the host drops it. Deterministic.
/// Not thread-safe, but other threads may read `database()` meanwhile. Memory: the database, 48
/// bytes an image, and what the last few queries led to.
///
/// Source: Galvez-Lopez & Tardos, T-RO 2012 (normalization, islands, temporal consistency);
/// Mur-Artal, Montiel & Tardos, T-RO 2015 (covisibility consistency). Departures: islands are
/// ranked by the sum of normalized scores; a run of consistent queries survives `max_missed`
/// queries without the place; more than one island and candidate is verified.
class LoopDetector {
 public:
  /// Starts with what `database` holds, in its order. Throws InvalidArgument for invalid options, a
  /// scoring of which lower scores are better, or kCovisibility without `neighbours`.
  explicit LoopDetector(Database database, const LoopDetectorOptions& options = {},
                        NeighboursOf neighbours = {});

  /// Looks for the place of a query; `verify` empty: geometry is not asked.
  ///
  /// Remembers the query for the consistency and the normalization of the next one; stores nothing.
  /// Throws InvalidArgument if query.bow is null or as Database::query does, and what `verify`
  /// throws. Cost of Database::query, twice with covisible images, and of the verifications.
  LoopResult detect(const LoopQuery& query, const VerifyLoop& verify = {});

  /// Stores an image. Throws as Database::add.
  void add(std::uint64_t id, const BowVector& bow);
  /// Takes an image out; false if it was not stored.
  bool remove(std::uint64_t id);

  /// Forgets the queries before, for example after a loop was closed or tracking was lost; the
  /// images stay.
  void forget_queries();

  const Database& database() const { return database_; }
  const LoopDetectorOptions& options() const { return options_; }

 private:
  struct Run {
    std::vector<std::uint64_t> group;  // ids, or with kOrder first and last order
    int length = 1;
    int missed = 0;
  };
  void note(std::uint64_t id);
  std::vector<std::uint64_t> excluded(const LoopQuery& query) const;
  double normalizer(const LoopQuery& query) const;
  std::vector<LoopIsland> islands(std::vector<LoopCandidate> candidates) const;
  std::vector<std::uint64_t> group_of(const LoopIsland& island) const;
  bool same_place(const std::vector<std::uint64_t>& a, const std::vector<std::uint64_t>& b) const;
  std::vector<Run> continue_runs(std::vector<LoopIsland>& islands) const;
  LoopReason find_candidates(const LoopQuery& query, const std::vector<std::uint64_t>& skip,
                             std::vector<LoopCandidate>& candidates, LoopResult& result) const;
  bool verify_island(const LoopQuery& query, const VerifyLoop& verify, const LoopIsland& island,
                     LoopResult& result) const;
  bool was_elsewhere(const LoopQuery& query, const VerifyLoop& verify, LoopResult& result) const;
  void verify_islands(const LoopQuery& query, const VerifyLoop& verify, LoopResult& result) const;

  Database database_;
  LoopDetectorOptions options_;
  NeighboursOf neighbours_;
  std::unordered_map<std::uint64_t, std::size_t> order_;  // id -> order of addition
  std::deque<std::uint64_t> recent_;                      // the last ids added
  std::vector<std::uint64_t> sequence_;                   // ids by order, removed ones too
  BowVector previous_;
  std::vector<Run> runs_;
};

}  // namespace dynslam::loop
