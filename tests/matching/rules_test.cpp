#include "dynslam/matching/rules.hpp"

#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/matching/named_rule.hpp"
#include "dynslam/matching/reject.hpp"

namespace {

namespace dm = dynslam::matching;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct Verdict {
  std::vector<std::uint8_t> keep;
  std::vector<float> weight;
  dm::Rejection summary;
};

/// Matches that move to the right by the given lengths.
template <typename Rule>
Verdict run_lengths(const Rule& rule, const std::vector<float>& lengths) {
  std::vector<dm::Keypoint> a(lengths.size()), b(lengths.size());
  for (std::size_t i = 0; i < lengths.size(); ++i) b[i].x = lengths[i];
  Verdict answer{std::vector<std::uint8_t>(lengths.size()), std::vector<float>(lengths.size()), {}};
  dm::Workspace workspace;
  answer.summary = dm::reject_pairs(rule, a, b, answer.keep, answer.weight, workspace);
  return answer;
}

/// Key points of the first image at angle 0, of the second at the given angles.
Verdict run_angles(const std::vector<float>& turns,
                   const dm::RotationConsistencyOptions& options = {}) {
  std::vector<dm::Keypoint> a(turns.size()), b(turns.size());
  for (std::size_t i = 0; i < turns.size(); ++i) {
    a[i].angle = 0.0F;
    b[i].angle = turns[i];
  }
  Verdict answer{std::vector<std::uint8_t>(turns.size()), std::vector<float>(turns.size()), {}};
  dm::Workspace workspace;
  answer.summary = dm::reject_pairs(dm::RotationConsistency(options), a, b, answer.keep,
                                    answer.weight, workspace);
  return answer;
}

using Flags = std::vector<std::uint8_t>;

TEST(ModalBin, KeepsTheFullestBinOfAHandCountedHistogram) {
  // N = 9: gamma = 3, L = (30 - 0) / 3 = 10. Bins: [0,10) 3, [10,20) 4, [20,30) 1, [30,40) 1.
  const Verdict answer = run_lengths(dm::ModalBin(), {0, 1, 9.9F, 10, 11, 12, 19, 20, 30});
  EXPECT_EQ(answer.keep, (Flags{0, 0, 0, 1, 1, 1, 1, 0, 0}));
  EXPECT_FLOAT_EQ(answer.weight[0], 0.75F);
  EXPECT_FLOAT_EQ(answer.weight[3], 1.0F);
  EXPECT_FLOAT_EQ(answer.weight[8], 0.25F);
}

TEST(ModalBin, KeepsAllBinsThatAreAsFullAsTheFullest) {
  // N = 4: gamma = 2, L = 5. Bins: 2, 0 and (dmax alone in the half-open paper's last) 2.
  EXPECT_EQ(run_lengths(dm::ModalBin(), {0, 1, 10, 10}).keep, (Flags{1, 1, 1, 1}));
}

TEST(ModalBin, AgreesWithAPlainCountOnRandomDisplacements) {
  std::mt19937 random(7);
  for (int round = 0; round < 50; ++round) {
    std::vector<float> lengths(1 + random() % 300);
    for (float& d : lengths) d = static_cast<float>(random() % 4096) / 64.0F;
    const double n = static_cast<double>(lengths.size());
    const double gamma = std::ceil(std::sqrt(n));
    const double low = *std::min_element(lengths.begin(), lengths.end());
    const double high = *std::max_element(lengths.begin(), lengths.end());
    std::map<long, int> bins;
    const auto bin = [&](float d) {
      const double width = (high - low) / gamma;
      const double origin = low < width ? 0.0 : low;
      return high > low ? static_cast<long>((d - origin) / width) : 0L;
    };
    int most = 0;
    for (const float d : lengths) most = std::max(most, ++bins[bin(d)]);
    const Verdict answer = run_lengths(dm::ModalBin(), lengths);
    for (std::size_t i = 0; i < lengths.size(); ++i) {
      ASSERT_EQ(answer.keep[i] != 0, bins[bin(lengths[i])] == most) << "round " << round;
    }
  }
}

TEST(ModalBin, CountsFromTheShortestWhereThePapersBinsWouldNotReach) {
  // L = (106 - 100) / 3 = 2, dmin > L: bins [100, 102), [102, 104), [104, 106), [106, 108).
  EXPECT_EQ(run_lengths(dm::ModalBin(), {100, 101, 101.5F, 102, 103, 104, 106, 101.9F, 105}).keep,
            (Flags{1, 1, 1, 0, 0, 0, 0, 1, 0}));
}

TEST(FractionOfMode, KeepsBinsThatHoldEnough) {
  const std::vector<float> lengths = {0, 1, 9.9F, 10, 11, 12, 19, 20, 30};
  EXPECT_EQ(run_lengths(dm::FractionOfMode(0.75), lengths).keep,
            (Flags{1, 1, 1, 1, 1, 1, 1, 0, 0}));
  EXPECT_EQ(run_lengths(dm::FractionOfMode(0.2), lengths).summary.kept, 9U);
}

TEST(FractionOfMode, WithOneIsModalBin) {
  const std::vector<float> lengths = {3, 4, 1, 7, 7.1F, 7.2F, 12, 30, 31, 2};
  EXPECT_EQ(run_lengths(dm::FractionOfMode(1.0), lengths).keep,
            run_lengths(dm::ModalBin(), lengths).keep);
}

TEST(ContiguousMode, StopsAtTheFirstGap) {
  // N = 16: gamma = 4, L = 10. Counts 6, 5, 0, 4, 1: the last two lie behind the gap.
  const std::vector<float> lengths = {0, 1, 2, 3, 4, 5, 10, 11, 12, 13, 14, 30, 31, 32, 33, 40};
  const Verdict contiguous = run_lengths(dm::ContiguousMode(0.15), lengths);
  EXPECT_EQ(contiguous.summary.kept, 11U);
  EXPECT_EQ(contiguous.keep[11], 0);
  EXPECT_EQ(run_lengths(dm::FractionOfMode(0.15), lengths).summary.kept, 16U);
}

TEST(ContiguousMode, GrowsToBothSides) {
  // Counts 2, 3, 6, 3, 2 around the middle.
  const std::vector<float> lengths = {0, 1, 10, 11, 12, 20, 21, 22, 23, 24, 25, 30, 31, 32, 40, 40};
  EXPECT_EQ(run_lengths(dm::ContiguousMode(0.5), lengths).keep,
            (Flags{0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0}));
}

TEST(HistogramRules, KeepOneMatchAndKeepAllThatMoveByTheSame) {
  for (const char* name : {"ModalBin", "FractionOfMode", "ContiguousMode"}) {
    const dm::NamedRule rule = dm::make_rule(name);
    EXPECT_EQ(run_lengths(rule, {}).summary.kept, 0U) << name;
    EXPECT_EQ(run_lengths(rule, {5.0F}).keep, Flags{1}) << name;
    EXPECT_EQ(run_lengths(rule, {5.0F, 5.0F, 5.0F}).keep, (Flags{1, 1, 1})) << name;
    EXPECT_EQ(run_lengths(rule, {5.0F, 5.0F, 5.0F}).weight, (std::vector<float>{1, 1, 1})) << name;
    EXPECT_EQ(run_lengths(rule, {1.0F, 9.0F}).summary.usable, 2U) << name;
  }
}

TEST(HistogramRules, DoNotCountNanPoints) {
  const Verdict answer = run_lengths(dm::ModalBin(), {kNan, 0, 1, 10, 20, kNan});
  EXPECT_EQ(answer.keep, (Flags{0, 1, 1, 0, 0, 0}));
  EXPECT_EQ(answer.weight[0], 0.0F);
  EXPECT_EQ(answer.summary.usable, 4U);
}

TEST(FractionOfMode, RefusesAFractionOutsideZeroToOne) {
  EXPECT_THROW(dm::FractionOfMode(0.0), dynslam::InvalidArgument);
  EXPECT_THROW(dm::FractionOfMode(1.1), dynslam::InvalidArgument);
  EXPECT_THROW(dm::FractionOfMode{kNan}, dynslam::InvalidArgument);
}

TEST(ContiguousMode, RefusesAFractionOutsideZeroToOne) {
  EXPECT_THROW(dm::ContiguousMode(-0.1), dynslam::InvalidArgument);
  EXPECT_THROW(dm::ContiguousMode{kNan}, dynslam::InvalidArgument);
}

TEST(NullRule, KeepsEverythingButWhatIsNotFinite) {
  const Verdict answer = run_lengths(dm::NullRule(), {1, kNan, 700});
  EXPECT_EQ(answer.keep, (Flags{1, 0, 1}));
  EXPECT_EQ(answer.weight, (std::vector<float>{1, 0, 1}));
}

TEST(RotationConsistency, KeepsTheTurnMostAgreeOn) {
  dm::RotationConsistencyOptions options;
  options.kept_peaks = 1;
  const Verdict answer = run_angles({35, 36, 37, 38, 200, 90}, options);
  EXPECT_EQ(answer.keep, (Flags{1, 1, 1, 1, 0, 0}));
  EXPECT_FLOAT_EQ(answer.weight[4], 0.25F);
}

TEST(RotationConsistency, DoesNotSplitSmallTurnsAtZeroDegrees) {
  dm::RotationConsistencyOptions options;
  options.kept_peaks = 1;
  EXPECT_EQ(run_angles({359, 358, 1, 2, 0, 100, 101}, options).keep, (Flags{1, 1, 1, 1, 1, 0, 0}));
}

TEST(RotationConsistency, DropsPeaksThatAreMuchLowerThanTheFirst) {
  std::vector<float> turns(40, 12.0F);
  turns.push_back(180.0F);
  EXPECT_EQ(run_angles(turns).summary.kept, 40U);
}

TEST(RotationConsistency, KeepsWhatHasNoAngle) {
  EXPECT_EQ(run_angles({kNan, kNan}).keep, (Flags{1, 1}));
  std::vector<float> turns(20, 45.0F);
  turns.push_back(kNan);
  turns.push_back(250.0F);
  const Verdict answer = run_angles(turns);
  EXPECT_EQ(answer.keep[20], 1);
  EXPECT_EQ(answer.keep[21], 0);
}

TEST(RotationConsistencyOptions, RefuseWhatMakesNoSenseByName) {
  const auto message = [](auto change) {
    dm::RotationConsistencyOptions options;
    change(options);
    try {
      dm::RotationConsistency rule(options);
    } catch (const dynslam::InvalidArgument& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  EXPECT_NE(message([](auto& o) { o.bins = 2; }).find("bins"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.kept_peaks = 31; }).find("kept_peaks"), std::string::npos);
  EXPECT_NE(message([](auto& o) { o.minimum_share = 2; }).find("minimum_share"), std::string::npos);
}

TEST(NamedRule, KnowsEveryNameAndListsThemForAWrongOne) {
  for (const auto name : dm::kRuleNames) EXPECT_EQ(dm::make_rule(name).name(), name);
  EXPECT_EQ(dm::make_rule("MotionConsensus").name(), "default");
  try {
    dm::make_rule("magic");
    FAIL() << "no error";
  } catch (const dynslam::InvalidArgument& error) {
    EXPECT_NE(std::string(error.what()).find("ContiguousMode"), std::string::npos);
  }
}

}  // namespace
