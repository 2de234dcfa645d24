// Rules take their memory from a workspace, which asks the system only when it grows.
#include <cstddef>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/matching/chain.hpp"
#include "dynslam/matching/named_rule.hpp"
#include "dynslam/matching/reject.hpp"

#include "allocation_counter.hpp"
#include "matching/synthetic_pairs.hpp"

namespace dynslam::matching {
namespace {

using dynslam::testing::Allocations;
using dynslam::testing::allocations_of;

synthetic::Pairs some_pairs(std::size_t matches, bool angles) {
  synthetic::Setup setup;
  setup.matches = matches;
  setup.camera.translation << -0.2, 0.0, 0.05;
  setup.angles = angles;
  return synthetic::make_pairs(setup);
}

TEST_F(Allocations, OfRulesAreNoneFromTheSecondCallOn) {
  const synthetic::Pairs pairs = some_pairs(300, true);
  std::vector<std::uint8_t> keep(pairs.matches.size());
  std::vector<float> weight(pairs.matches.size());
  const auto everything = chain(RotationConsistency(), FractionOfMode(0.01), ContiguousMode(0.01),
                                NullRule(), DefaultRule());
  Workspace workspace;
  const auto call = [&](const auto& rule) {
    reject(rule, pairs.matches, pairs.points1, pairs.points2, keep, weight, workspace);
  };
  EXPECT_GT(allocations_of([&] { call(everything); }), 0);
  EXPECT_EQ(allocations_of([&] { call(everything); }), 0);
  EXPECT_EQ(allocations_of([&] { call(ModalBin()); }), 0);
}

TEST_F(Allocations, OfTheFirstCallAreNoneInAWorkspaceReservedAhead) {
  for (const bool angles : {true, false}) {
    const synthetic::Pairs pairs = some_pairs(2000, angles);
    std::vector<std::uint8_t> keep(pairs.matches.size());
    std::vector<float> weight(pairs.matches.size());
    Workspace workspace(2000);
    EXPECT_EQ(allocations_of([&] {
                reject(DefaultRule(), pairs.matches, pairs.points1, pairs.points2, keep, weight,
                       workspace);
              }),
              0);
  }
}

}  // namespace
}  // namespace dynslam::matching
