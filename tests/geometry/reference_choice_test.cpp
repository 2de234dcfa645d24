#include "dynslam/geometry/reference_choice.hpp"

#include <cmath>
#include <map>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "geometry/synthetic.hpp"

namespace dynslam::geometry {
namespace {

using synthetic::kCamera;

TEST(ReferenceChoice, RanksKeyframesBySharedPoints) {
  const std::map<std::uint64_t, std::vector<std::uint64_t>> observers{
      {1, {10, 11, 12}}, {2, {11, 12}}, {3, {12, 13}}, {4, {13}}};
  const auto visit_observers = [&](std::uint64_t point, const auto& visit) {
    const auto it = observers.find(point);
    if (it == observers.end()) return;
    for (const std::uint64_t keyframe : it->second) visit(keyframe);
  };
  const std::vector<std::uint64_t> points{1, 2, 3, 4, 99};
  std::vector<SharedKeyframe> out(3);
  ReferenceChoiceWorkspace workspace;
  ASSERT_EQ(choose_by_covisibility(points, visit_observers, 1, workspace, out), 3U);
  EXPECT_EQ(out[0].id, 12U);
  EXPECT_EQ(out[0].shared, 3);
  EXPECT_EQ(out[1].id, 13U);  // two as well, but newer
  EXPECT_EQ(out[2].id, 11U);
  EXPECT_EQ(choose_by_covisibility(points, visit_observers, 3, workspace, out), 1U);
  EXPECT_EQ(choose_by_covisibility({}, visit_observers, 1, workspace, out), 0U);
  EXPECT_THROW(choose_by_covisibility(points, visit_observers, 0, workspace, out), InvalidArgument);
}

TEST(ReferenceChoice, SpreadsReferencesOverTime) {
  std::vector<ReferenceCandidate> candidates;
  for (int i = 0; i <= 50; ++i) candidates.push_back({static_cast<std::uint64_t>(i), 0.1 * i, {}});
  std::vector<int> out(5);
  ASSERT_EQ(choose_depth_references(kCamera, 5.0, candidates, {}, out), 5U);
  EXPECT_EQ(out, (std::vector<int>{48, 46, 42, 34, 18}));
}

TEST(ReferenceChoice, LeavesOutWhatLookedElsewhere) {
  std::vector<ReferenceCandidate> candidates{{0, 0.0, {}}, {1, 0.5, {}}, {2, 0.8, {}}};
  candidates[1].T_cur_ref.R = so3_exp({0, 2.0, 0});
  candidates[2].T_cur_ref.t.x() = std::nan("");
  std::vector<int> out(5);
  ASSERT_EQ(choose_depth_references(kCamera, 1.0, candidates, {}, out), 1U);
  EXPECT_EQ(out[0], 0);
  EXPECT_EQ(choose_depth_references(kCamera, 1.0, {}, {}, out), 0U);
  EXPECT_EQ(choose_depth_references(kCamera, 0.0, candidates, {}, out), 0U);  // none is older
}

TEST(ReferenceChoice, RefusesEachInvalidOption) {
  using O = DepthReferenceOptions;
  for (double O::*member : {&O::first_gap, &O::depth}) {
    O options;
    options.*member = 0.0;
    EXPECT_THROW(options.validate(), InvalidArgument);
  }
  O options;
  options.ratio = 1.0;
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = O();
  options.min_overlap = 1.1;
  EXPECT_THROW(options.validate(), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::geometry
