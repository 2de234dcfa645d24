#include "dynslam/factors/static_weight.hpp"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/numeric_derivative.hpp"
#include "dynslam/factors/robust_loss.hpp"

namespace dynslam::factors {
namespace {

const double kNotANumber = std::nan("");

TEST(InitialWeight, OfTwoDetectorsIsThePapersSum) {
  const DetectorVote votes[] = {{1.0, 0.5}, {0.0, 0.5}};
  EXPECT_DOUBLE_EQ(initial_weight(votes), 0.5);
  const DetectorVote biased[] = {{0.0, 0.3}, {1.0, 0.7}};
  EXPECT_DOUBLE_EQ(initial_weight(biased), 0.7);
}

TEST(InitialWeight, LeavesOutDetectorsWithoutAnOpinion) {
  const DetectorVote votes[] = {{kNotANumber, 0.5}, {0.8, 0.25}, {0.2, 0.25}};
  EXPECT_DOUBLE_EQ(initial_weight(votes), 0.5);
}

TEST(InitialWeight, WithoutAnyOpinionIsThePreviousWeightOrUnknown) {
  EXPECT_DOUBLE_EQ(initial_weight({}), 0.5);
  EXPECT_DOUBLE_EQ(initial_weight({}, kNotANumber, {0.0, 0.9}), 0.9);
  EXPECT_DOUBLE_EQ(initial_weight({}, 0.3), 0.3);
  const DetectorVote idle[] = {{1.0, 0.0}};
  EXPECT_DOUBLE_EQ(initial_weight(idle, 0.3), 0.3);
}

TEST(InitialWeight, RemembersByItsMomentum) {
  const DetectorVote votes[] = {{1.0, 1.0}};
  EXPECT_DOUBLE_EQ(initial_weight(votes, 0.2, {0.25, 0.5}), 0.8);
  EXPECT_DOUBLE_EQ(initial_weight(votes, kNotANumber, {0.25, 0.5}), 1.0);
}

TEST(InitialWeight, RefusesBrokenInputByName) {
  const auto message = [](auto&& call) {
    try {
      call();
    } catch (const InvalidArgument& e) {
      return std::string(e.what());
    }
    return std::string("nothing thrown");
  };
  const DetectorVote high[] = {{1.5, 0.5}};
  const DetectorVote negative[] = {{1.0, -0.5}};
  EXPECT_NE(message([&] { initial_weight(high); }).find("votes.staticness"), std::string::npos);
  EXPECT_NE(message([&] { initial_weight(negative); }).find("votes.contribution"),
            std::string::npos);
  EXPECT_NE(message([&] { initial_weight({}, 1.1); }).find("previous"), std::string::npos);
  EXPECT_NE(message([&] {
              initial_weight({}, 0.5, {1.0, 0.5});
            }).find("momentum"),
            std::string::npos);
  EXPECT_NE(message([&] {
              initial_weight({}, 0.5, {0.0, kNotANumber});
            }).find("unknown"),
            std::string::npos);
}

TEST(OptimalWeight, MinimizesTheJointCost) {
  for (const double phi0 : {0.0, 0.1, 0.5, 1.0}) {
    for (const double s : {0.0, 0.3, 9.0, 1e4}) {
      for (const double lambda : {0.5, 9.0, 100.0}) {
        const double best = optimal_weight(phi0, s, lambda);
        EXPECT_GE(best, 0.0);
        EXPECT_LE(best, phi0);
        const double cost = weighted_cost(best, phi0, s, lambda);
        EXPECT_NEAR(cost, eliminated_cost(phi0, s, lambda), 1e-12 * (1.0 + cost));
        for (double phi = 0.0; phi <= 1.0; phi += 1.0 / 64.0)
          EXPECT_GE(weighted_cost(phi, phi0, s, lambda), cost * (1.0 - 1e-12));
      }
    }
  }
}

TEST(OptimalWeight, OfAnInfiniteResidualIsZero) {
  EXPECT_EQ(optimal_weight(1.0, std::numeric_limits<double>::infinity(), 9.0), 0.0);
}

TEST(EliminatedCost, IsAGemanMcClureLossWeightedByThePrior) {
  const RobustLoss loss{LossKind::kGemanMcClure, 3.0, 0.0};
  for (const double s : {0.0, 1.0, 20.0})
    EXPECT_NEAR(eliminated_cost(0.5, s, 9.0), 0.5 * 0.25 * loss(s).rho, 1e-14);
}

TEST(UpdateWeights, WorksInPlaceAndTrustsNothingThatIsNotMeasured) {
  std::vector<float> phi = {1.0F, 0.5F, 1.0F};
  const std::vector<float> s = {0.0F, 9.0F, std::numeric_limits<float>::quiet_NaN()};
  update_weights(phi, s, 9.0, phi);
  EXPECT_FLOAT_EQ(phi[0], 1.0F);
  EXPECT_FLOAT_EQ(phi[1], 0.25F);
  EXPECT_FLOAT_EQ(phi[2], 0.0F);
}

TEST(UpdateWeights, RefusesOtherSizesAndStiffness) {
  std::vector<float> three(3, 0.5F), two(2, 0.5F);
  EXPECT_THROW(update_weights(three, two, 9.0, three), InvalidArgument);
  EXPECT_THROW(update_weights(three, three, 9.0, two), InvalidArgument);
  EXPECT_THROW(update_weights(three, three, 0.0, three), InvalidArgument);
  EXPECT_THROW(update_weights(three, three, kNotANumber, three), InvalidArgument);
}

class LossTest : public ::testing::TestWithParam<RobustLoss> {};

TEST_P(LossTest, HasTheDerivativesItSays) {
  const RobustLoss loss = GetParam();
  using Scalar = Eigen::Matrix<double, 1, 1>;
  for (const double s : {0.01, 0.7, 3.0, 30.0, 1e3}) {
    const auto rho = [&](const Scalar& x) { return Scalar(loss(x[0]).rho); };
    const auto rho1 = [&](const Scalar& x) { return Scalar(loss(x[0]).rho1); };
    EXPECT_NEAR(loss(s).rho1, numeric_jacobian(rho, Scalar(s), 1e-3 * std::min(1.0, s))(0, 0),
                1e-7);
    EXPECT_NEAR(loss(s).rho2, numeric_jacobian(rho1, Scalar(s), 1e-3 * std::min(1.0, s))(0, 0),
                1e-7);
  }
}

TEST_P(LossTest, IsTheSquareNearZero) {
  EXPECT_EQ(GetParam()(0.0).rho, 0.0);
  EXPECT_NEAR(GetParam()(1e-8).rho, 1e-8, 1e-15);
  EXPECT_DOUBLE_EQ(GetParam()(0.0).rho1, 1.0);
}

INSTANTIATE_TEST_SUITE_P(Kinds, LossTest,
                         ::testing::Values(RobustLoss{}, RobustLoss{LossKind::kHuber, 2.447, 0.0},
                                           RobustLoss{LossKind::kCauchy, 2.0, 0.0},
                                           RobustLoss{LossKind::kGemanMcClure, 3.0, 0.0},
                                           RobustLoss{LossKind::kBarron, 2.0, 2.0},
                                           RobustLoss{LossKind::kBarron, 2.0, 1.0},
                                           RobustLoss{LossKind::kBarron, 2.0, 0.0},
                                           RobustLoss{LossKind::kBarron, 2.0, -2.0},
                                           RobustLoss{LossKind::kBarron, 2.0, -10.0}));

TEST(RobustLoss, OfBarronContainsTheOthers) {
  for (const double s : {0.1, 4.0, 50.0}) {
    EXPECT_NEAR((RobustLoss{LossKind::kBarron, 2.0, 0.0}(s).rho),
                (RobustLoss{LossKind::kCauchy, 2.0 * std::sqrt(2.0), 0.0}(s).rho), 1e-12);
    EXPECT_NEAR((RobustLoss{LossKind::kBarron, 2.0, -2.0}(s).rho),
                (RobustLoss{LossKind::kGemanMcClure, 4.0, 0.0}(s).rho), 1e-12);
    EXPECT_NEAR((RobustLoss{LossKind::kBarron, 2.0, 1e-7}(s).rho),
                (RobustLoss{LossKind::kBarron, 2.0, 0.0}(s).rho), 1e-5);
  }
}

TEST(RobustLoss, RefusesScalesAndShapesOutsideItsRules) {
  EXPECT_THROW((RobustLoss{LossKind::kHuber, 0.0, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((RobustLoss{LossKind::kHuber, kNotANumber, 0.0}.validate()), InvalidArgument);
  EXPECT_THROW((RobustLoss{LossKind::kBarron, 1.0, 2.5}.validate()), InvalidArgument);
  EXPECT_NO_THROW((RobustLoss{LossKind::kHuber, 1.0, 2.5}.validate()));
}

}  // namespace
}  // namespace dynslam::factors
