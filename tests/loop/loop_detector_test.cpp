#include "dynslam/loop/loop_detector.hpp"

#include <cmath>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::loop {
namespace {

constexpr std::size_t kAllWords = 1000;

// Image of place p on a walk past places: it shares words with its two neighbours on both sides.
BowVector place(std::size_t p) {
  BowVector bow;
  for (std::size_t i = 0; i < 30; ++i)
    bow.push_back(static_cast<WordId>((10 * p + i) % kAllWords), 1.0);
  bow.normalize(Norm::kL1);
  return bow;
}

Verification verified(std::size_t inliers) {
  Verification result;
  result.verdict = Verdict::kVerified;
  result.matches = 2 * inliers;
  result.inliers = inliers;
  result.confidence = static_cast<double>(inliers) / 10.0;
  return result;
}

Verification refused(Verdict verdict, std::size_t inliers = 3) {
  Verification result = verified(inliers);
  result.verdict = verdict;
  return result;
}

LoopDetectorOptions quick() {
  LoopDetectorOptions options;
  options.normalization = Normalization::kPreviousQuery;
  options.exclude_recent = 5;
  options.consistency = 1;
  options.probes = 0;
  return options;
}

/// A walk past places 0, 1, 2, ...; ids are 100 plus the number of the step.
struct Walk {
  explicit Walk(const LoopDetectorOptions& options, NeighboursOf neighbours = {})
      : detector(Database(kAllWords), options, std::move(neighbours)) {}

  LoopResult step(const BowVector& bow, const VerifyLoop& verify = {}) {
    LoopQuery query;
    query.id = 100 + steps;
    query.bow = &bow;
    query.covisible = covisible;
    const LoopResult result = detector.detect(query, verify);
    detector.add(query.id, bow);
    ++steps;
    return result;
  }
  void past(std::size_t first, std::size_t count, const VerifyLoop& verify = {}) {
    for (std::size_t p = first; p < first + count; ++p) EXPECT_FALSE(step(place(p), verify));
  }

  LoopDetector detector;
  std::vector<std::uint64_t> covisible;
  std::size_t steps = 0;
};

const VerifyLoop kYes = [](std::uint64_t, std::uint64_t) { return verified(40); };

TEST(LoopDetector, FindsThePlaceThatItComesBackTo) {
  Walk walk(quick());
  walk.past(0, 40);
  walk.step(place(9));
  const LoopResult result = walk.step(place(10), kYes);
  ASSERT_TRUE(result);
  EXPECT_EQ(result.reason, LoopReason::kLoop);
  EXPECT_EQ(result.query, 141u);
  EXPECT_TRUE(result.has_match);
  // All neighbours verify alike, so the best in words stays.
  EXPECT_EQ(result.match, 110u);
  EXPECT_NEAR(result.best_score, 1.0, 1e-3);
  EXPECT_EQ(result.verification.inliers, 40u);
}

TEST(LoopDetector, TakesTheCandidateOfAnIslandWithTheMostInliers) {
  Walk walk(quick());
  walk.past(0, 40);
  walk.step(place(9));
  const LoopResult result = walk.step(place(10), [](std::uint64_t, std::uint64_t candidate) {
    return verified(candidate == 111 ? 60 : 40);
  });
  ASSERT_TRUE(result);
  EXPECT_EQ(result.match, 111u);
}

TEST(LoopDetector, RefusesAnEmptyQuery) {
  Walk walk(quick());
  walk.past(0, 40);
  const LoopResult result = walk.step({}, kYes);
  EXPECT_EQ(result.reason, LoopReason::kEmptyQuery);
  EXPECT_FALSE(result.has_match);
  // A dark frame does not spoil the normalizer of the next one.
  walk.step(place(40));
  EXPECT_GT(walk.step(place(10), kYes).best_score, 0.9);
}

TEST(LoopDetector, RefusesWhereFewPlacesAreStoredBesideTheRecentOnes) {
  LoopDetectorOptions options = quick();
  options.min_places = 10;
  Walk walk(options);
  for (std::size_t p = 0; p < 15; ++p)
    EXPECT_EQ(walk.step(place(p)).reason, LoopReason::kTooFewPlaces);
  EXPECT_NE(walk.step(place(15)).reason, LoopReason::kTooFewPlaces);
}

TEST(LoopDetector, RefusesWhereNoWordIsShared) {
  Walk walk(quick());
  walk.past(0, 20);
  EXPECT_EQ(walk.step(place(50), kYes).reason, LoopReason::kNoSharedWord);
}

TEST(LoopDetector, RefusesAQueryThatIsUnlikeItsNeighbour) {
  Walk walk(quick());
  walk.past(0, 40);
  walk.step(place(60));
  const LoopResult result = walk.step(place(10), kYes);
  EXPECT_EQ(result.reason, LoopReason::kWeakNeighbour);
  EXPECT_EQ(result.match, 110u);
  EXPECT_EQ(result.normalizer, 0.0);
}

TEST(LoopDetector, RefusesAScoreThatIsLowBesideTheNormalizer) {
  LoopDetectorOptions options = quick();
  options.min_score = 0.9;
  Walk walk(options);
  walk.past(0, 40);
  BowVector half = place(10);
  for (WordId word = 900; word < 960; ++word) half.add(word, 1.0 / 60.0);
  half.normalize(Norm::kL1);
  walk.step(half);
  const LoopResult result = walk.step(half, kYes);
  EXPECT_EQ(result.reason, LoopReason::kLowScore);
  EXPECT_NEAR(result.normalizer, 1.0, 1e-9);
  EXPECT_NEAR(result.best_normalized, 0.5, 1e-2);
  EXPECT_EQ(result.candidates, 0u);
}

TEST(LoopDetector, WantsSeveralQueriesInARowAtOnePlace) {
  LoopDetectorOptions options = quick();
  options.consistency = 3;
  options.max_missed = 0;
  Walk walk(options);
  walk.past(0, 40);
  walk.step(place(9));  // far from place 39 and so without a normalizer
  LoopResult result = walk.step(place(10), kYes);
  EXPECT_EQ(result.reason, LoopReason::kInconsistent);
  ASSERT_FALSE(result.islands.empty());
  EXPECT_EQ(result.islands[0].consistent, 1);
  EXPECT_EQ(walk.step(place(11), kYes).reason, LoopReason::kInconsistent);
  result = walk.step(place(12), kYes);
  EXPECT_EQ(result.reason, LoopReason::kLoop);
  EXPECT_EQ(result.match, 112u);
}

TEST(LoopDetector, BridgesAMissedQueryIfToldTo) {
  for (const int missed : {0, 1}) {
    LoopDetectorOptions options = quick();
    options.consistency = 3;
    options.max_missed = missed;
    Walk walk(options);
    walk.past(0, 40);
    walk.step(place(9));
    walk.step(place(10), kYes);
    walk.step(place(11), kYes);
    walk.step({}, kYes);
    EXPECT_EQ(walk.step(place(12), kYes).reason,
              missed == 1 ? LoopReason::kLoop : LoopReason::kInconsistent);
  }
}

TEST(LoopDetector, ForgetsRunsAndNormalizerWhenToldTo) {
  LoopDetectorOptions options = quick();
  options.consistency = 2;
  options.normalization = Normalization::kNone;
  Walk walk(options);
  walk.past(0, 40);
  EXPECT_EQ(walk.step(place(10), kYes).reason, LoopReason::kInconsistent);
  walk.detector.forget_queries();
  EXPECT_EQ(walk.step(place(11), kYes).reason, LoopReason::kInconsistent);
  EXPECT_EQ(walk.step(place(12), kYes).reason, LoopReason::kLoop);
}

TEST(LoopDetector, AcceptsALoneCandidateThatIsFarAboveDoubtIfToldTo) {
  LoopDetectorOptions options = quick();
  options.consistency = 3;
  options.lone_confidence = 3.0;
  Walk walk(options);
  walk.past(0, 40);
  walk.step(place(9));
  const LoopResult weak =
      walk.step(place(10), [](std::uint64_t, std::uint64_t) { return verified(20); });
  EXPECT_EQ(weak.reason, LoopReason::kInconsistent);
  EXPECT_EQ(weak.verification.inliers, 20u);
  EXPECT_EQ(walk.step(place(11), kYes).reason, LoopReason::kLoop);
}

TEST(LoopDetector, SaysWhatTheVerificationSaid) {
  const std::pair<Verdict, LoopReason> kCases[] = {{Verdict::kFewMatches, LoopReason::kFewMatches},
                                                   {Verdict::kNoGeometry, LoopReason::kNoGeometry},
                                                   {Verdict::kOtherScene, LoopReason::kOtherScene},
                                                   {Verdict::kRefused, LoopReason::kRefusedByHost}};
  for (const auto& [verdict, reason] : kCases) {
    Walk walk(quick());
    walk.past(0, 40);
    walk.step(place(9));
    const LoopResult result =
        walk.step(place(10), [v = verdict](std::uint64_t, std::uint64_t candidate) {
          return refused(v, candidate == 109 ? 7 : 3);
        });
    EXPECT_EQ(result.reason, reason);
    EXPECT_EQ(result.match, 109u);  // the one that came farthest
    EXPECT_EQ(result.verification.inliers, 7u);
    EXPECT_GE(result.verified, 2u);
  }
}

TEST(LoopDetector, TellsAPlaceStillInViewFromALoop) {
  LoopDetectorOptions options = quick();
  options.probes = 4;
  Walk walk(options);
  walk.past(0, 40);
  walk.step(place(9));
  // The camera sees place 10 all the time: every image verifies.
  EXPECT_EQ(walk.step(place(10), kYes).reason, LoopReason::kStillInView);
  // It has looked elsewhere: images far from the match do not.
  const LoopResult left = walk.step(place(11), [](std::uint64_t, std::uint64_t candidate) {
    return candidate < 120 ? verified(40) : refused(Verdict::kNoGeometry);
  });
  EXPECT_EQ(left.reason, LoopReason::kLoop);
}

TEST(LoopDetector, OneBlurredImageInBetweenIsNotElsewhere) {
  LoopDetectorOptions options = quick();
  options.probes = 30;
  Walk walk(options);
  walk.past(0, 40);
  walk.step(place(9));
  const LoopResult result = walk.step(place(10), [](std::uint64_t, std::uint64_t candidate) {
    return candidate % 7 == 0 ? refused(Verdict::kFewMatches) : verified(40);
  });
  EXPECT_EQ(result.reason, LoopReason::kStillInView);
}

TEST(LoopDetector, NeverReturnsCovisibleOrRecentImages) {
  LoopDetectorOptions options = quick();
  options.exclude_recent = 2;
  options.normalization = Normalization::kNone;
  Walk walk(options);
  walk.past(0, 1);
  std::set<std::uint64_t> asked;
  for (std::size_t i = 0; i < 10; ++i) {
    walk.covisible = {103, 104};
    walk.step(place(0), [&](std::uint64_t query, std::uint64_t candidate) {
      asked.insert(candidate);
      EXPECT_LT(candidate + 2, query);
      return refused(Verdict::kNoGeometry);
    });
  }
  EXPECT_EQ(asked.count(103) + asked.count(104), 0u);
  EXPECT_EQ(asked.count(100), 1u);
}

TEST(LoopDetector, NormalizesByTheCovisibleImages) {
  for (const auto& [normalization, expected] :
       {std::pair<Normalization, double>{Normalization::kLeastCovisible, 2.0 / 3.0},
        {Normalization::kMedianCovisible, 1.0}}) {
    LoopDetectorOptions options = quick();
    options.normalization = normalization;
    Walk walk(options);
    walk.past(0, 11);
    walk.covisible = {109, 110, 555};
    walk.step(place(50));
    walk.step(place(51));
    walk.step(place(52));
    EXPECT_NEAR(walk.step(place(10)).normalizer, expected, 1e-3);
  }
}

TEST(LoopDetector, GroupsByCovisibilityWhereAskedTo) {
  LoopDetectorOptions options = quick();
  options.grouping = Grouping::kCovisibility;
  options.consistency = 2;
  // Odd ids know odd ids and even ids know even ones.
  Walk walk(options, [](std::uint64_t id) {
    return std::vector<std::uint64_t>{id - 4, id - 2, id + 2, id + 4};
  });
  walk.past(0, 40);
  walk.step(place(9));
  const LoopResult first = walk.step(place(10), kYes);
  EXPECT_EQ(first.reason, LoopReason::kInconsistent);
  for (const LoopIsland& island : first.islands) {
    for (const LoopCandidate& member : island.members)
      EXPECT_EQ(member.id % 2, island.members[0].id % 2);
  }
  EXPECT_EQ(walk.step(place(11), kYes).reason, LoopReason::kLoop);
}

TEST(LoopDetector, StartsWithWhatADatabaseHolds) {
  Database database(kAllWords);
  for (std::size_t p = 0; p < 40; ++p) database.add(100 + p, place(p));
  LoopDetectorOptions options = quick();
  options.normalization = Normalization::kNone;
  LoopDetector detector(std::move(database), options);
  const BowVector bow = place(10);
  LoopQuery query;
  query.id = 999;
  query.bow = &bow;
  EXPECT_EQ(detector.detect(query, kYes).match, 110u);
}

TEST(LoopDetector, DoesNotReturnARemovedImage) {
  LoopDetectorOptions options = quick();
  options.normalization = Normalization::kNone;
  Walk walk(options);
  walk.past(0, 40);
  EXPECT_TRUE(walk.detector.remove(110));
  EXPECT_FALSE(walk.detector.remove(110));
  EXPECT_TRUE(walk.detector.remove(139));  // a recent one
  const LoopResult result = walk.step(place(10), kYes);
  ASSERT_TRUE(result);
  EXPECT_NE(result.match, 110u);
}

TEST(LoopDetector, LetsTheHostsExceptionThroughAndStaysAsItWas) {
  LoopDetectorOptions options = quick();
  options.consistency = 2;
  options.normalization = Normalization::kNone;
  Walk walk(options);
  walk.past(0, 40);
  walk.step(place(10));
  const BowVector bow = place(11);
  LoopQuery query;
  query.id = 500;
  query.bow = &bow;
  const VerifyLoop broken = [](std::uint64_t, std::uint64_t) -> Verification {
    throw std::runtime_error("no");
  };
  EXPECT_THROW(walk.detector.detect(query, broken), std::runtime_error);
  const LoopResult again = walk.detector.detect(query, kYes);
  EXPECT_EQ(again.reason, LoopReason::kLoop);
  EXPECT_EQ(again.islands[0].consistent, 2);
}

TEST(LoopDetector, RefusesToWorkWithoutWhatItNeeds) {
  EXPECT_THROW(LoopDetector(Database(10, Scoring::kKullbackLeibler)), InvalidArgument);
  LoopDetectorOptions options;
  options.grouping = Grouping::kCovisibility;
  EXPECT_THROW(LoopDetector(Database(10), options), InvalidArgument);
  LoopDetector detector(Database(10));
  EXPECT_THROW(detector.detect({}), InvalidArgument);
}

TEST(LoopReason, HasANameForEachValue) {
  std::set<std::string_view> names;
  for (std::size_t i = 0; i < kLoopReasons; ++i)
    names.insert(to_string(static_cast<LoopReason>(i)));
  EXPECT_EQ(names.size(), kLoopReasons);
  EXPECT_EQ(names.count("unknown"), 0u);
  EXPECT_EQ(to_string(LoopReason::kStillInView), "StillInView");
}

TEST(LoopDetectorOptions, RefusesEachMemberThatBreaksItsRule) {
  const auto refuses = [](auto&& change) {
    LoopDetectorOptions options;
    EXPECT_NO_THROW(options.validate());
    change(options);
    EXPECT_THROW(options.validate(), InvalidArgument);
  };
  refuses([](auto& o) { o.min_places = 0; });
  refuses([](auto& o) { o.min_normalizer = 1.0; });
  refuses([](auto& o) { o.min_normalizer = std::nan(""); });
  refuses([](auto& o) { o.min_score = -0.1; });
  refuses([](auto& o) { o.min_score = std::nan(""); });
  refuses([](auto& o) { o.max_candidates = 0; });
  refuses([](auto& o) { o.consistency = 0; });
  refuses([](auto& o) { o.max_missed = -1; });
  refuses([](auto& o) { o.max_islands = 0; });
  refuses([](auto& o) { o.max_verified = 0; });
  refuses([](auto& o) { o.lone_confidence = 0.5; });
  refuses([](auto& o) { o.lone_confidence = std::nan(""); });
}

}  // namespace
}  // namespace dynslam::loop
