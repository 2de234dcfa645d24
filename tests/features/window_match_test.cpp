#include <algorithm>
#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/features/hamming_reference.hpp"
#include "dynslam/features/matcher.hpp"

#include "features/support.hpp"

namespace dynslam::features {
namespace {

using testing::kInfinity;
using testing::kNan;
using testing::noise;
using testing::uniform;
using testing::view;

/// A frame and predictions for it, owned.
struct Scene {
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  std::vector<std::uint8_t> taken;
  KeypointGrid grid;
  std::vector<cv::Point2f> positions;
  std::vector<float> radii;
  std::vector<int> min_octaves, max_octaves;
  cv::Mat predicted;

  WindowPredictions predictions() const {
    return {positions, radii, min_octaves, max_octaves, view(predicted)};
  }
  WindowFeatures features() const {
    return {&grid, field(keypoints, &cv::KeyPoint::octave), view(descriptors), taken};
  }
  std::vector<Match> match(const WindowOptions& options = {}) const {
    std::vector<Match> matches = {{5, 5, 5.0F}};
    match_windowed(predictions(), features(), options, matches);
    return matches;
  }
};

/// Features at random; predictions near some of them, with some bits of the descriptor turned.
Scene random_scene(int features, int predictions, unsigned seed) {
  std::mt19937 random(seed);
  Scene scene;
  // Few different bytes make ties of distances.
  scene.descriptors = noise(32, features, seed, 0, 3);
  for (int i = 0; i < features; ++i) {
    scene.keypoints.emplace_back(static_cast<float>(uniform(random, 0, 3199)) / 10.0F,
                                 static_cast<float>(uniform(random, 0, 2399)) / 10.0F, 31.0F, 0.0F,
                                 1.0F, uniform(random, 0, 7));
    scene.taken.push_back(uniform(random, 0, 9) == 0);
  }
  scene.grid.build(field(scene.keypoints, &cv::KeyPoint::pt), 320, 240);
  scene.predicted = cv::Mat(predictions, 32, CV_8UC1);
  for (int i = 0; i < predictions; ++i) {
    const int of = uniform(random, 0, features - 1);
    const cv::KeyPoint& k = scene.keypoints[static_cast<std::size_t>(of)];
    scene.positions.emplace_back(k.pt.x + static_cast<float>(uniform(random, -5, 5)),
                                 k.pt.y + static_cast<float>(uniform(random, -5, 5)));
    scene.radii.push_back(static_cast<float>(uniform(random, 0, 40)));
    scene.min_octaves.push_back(k.octave - 1);
    scene.max_octaves.push_back(k.octave + uniform(random, 0, 2));
    scene.descriptors.row(of).copyTo(scene.predicted.row(i));
    for (int bit = 0; bit < 12; ++bit) {
      scene.predicted.at<std::uint8_t>(i, uniform(random, 0, 31)) ^= 1;
    }
  }
  return scene;
}

struct Candidate {
  int distance;
  std::int32_t index;
  bool operator<(const Candidate& other) const {
    return std::pair(distance, index) < std::pair(other.distance, other.index);
  }
};

/// All candidates of a prediction, nearest first.
std::vector<Candidate> candidates_of(const Scene& scene, std::size_t i) {
  std::vector<Candidate> candidates;
  const float radius = scene.radii[i];
  if (!(radius > 0.0F)) return candidates;
  for (std::size_t j = 0; j < scene.keypoints.size(); ++j) {
    const cv::KeyPoint& k = scene.keypoints[j];
    if (std::abs(k.pt.x - scene.positions[i].x) > radius) continue;
    if (std::abs(k.pt.y - scene.positions[i].y) > radius) continue;
    if (!scene.min_octaves.empty() && k.octave < scene.min_octaves[i]) continue;
    if (!scene.max_octaves.empty() && k.octave > scene.max_octaves[i]) continue;
    if (!scene.taken.empty() && scene.taken[j] != 0) continue;
    const int distance = hamming_distance_reference(scene.predicted.ptr(static_cast<int>(i)),
                                                    scene.descriptors.ptr(static_cast<int>(j)), 32);
    candidates.push_back({distance, static_cast<std::int32_t>(j)});
  }
  std::sort(candidates.begin(), candidates.end());
  return candidates;
}

/// The definition, with loops.
std::vector<Match> by_hand(const Scene& scene, const WindowOptions& options) {
  std::vector<Match> matches;
  for (std::size_t i = 0; i < scene.positions.size(); ++i) {
    const std::vector<Candidate> candidates = candidates_of(scene, i);
    if (candidates.empty() || candidates[0].distance > options.max_distance) continue;
    if (options.ratio < 1.0F && candidates.size() > 1) {
      const auto octave = [&](std::size_t c) {
        return scene.keypoints[static_cast<std::size_t>(candidates[c].index)].octave;
      };
      const bool applies = !options.ratio_within_octave || octave(0) == octave(1);
      if (applies && !(static_cast<float>(candidates[0].distance) <
                       options.ratio * static_cast<float>(candidates[1].distance))) {
        continue;
      }
    }
    matches.push_back({static_cast<std::int32_t>(i), candidates[0].index,
                       static_cast<float>(candidates[0].distance)});
  }
  if (!options.one_to_one) return matches;
  std::vector<Match> kept;
  for (const Match& m : matches) {
    const bool beaten = std::any_of(matches.begin(), matches.end(), [&](const Match& other) {
      return other.train == m.train &&
             std::pair(other.distance, other.query) < std::pair(m.distance, m.query);
    });
    if (!beaten) kept.push_back(m);
  }
  return kept;
}

void expect_same(const std::vector<Match>& a, const std::vector<Match>& b,
                 const std::string& what) {
  ASSERT_EQ(a.size(), b.size()) << what;
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].query, b[i].query) << what;
    EXPECT_EQ(a[i].train, b[i].train) << what;
    EXPECT_EQ(a[i].distance, b[i].distance) << what;
  }
}

TEST(MatchWindowed, EqualsTheDefinitionOnAllTargetsForAllOptions) {
  for (const auto& [features, predictions] : {std::pair{1, 1}, {30, 50}, {400, 300}, {1500, 200}}) {
    const Scene scene = random_scene(features, predictions, 3);
    for (const int max_distance : {0, 12, 100}) {
      for (const float ratio : {1.0F, 0.8F}) {
        for (const int flags : {0, 1, 2, 3}) {
          WindowOptions options;
          options.max_distance = max_distance;
          options.ratio = ratio;
          options.ratio_within_octave = (flags & 1) != 0;
          options.one_to_one = (flags & 2) != 0;
          const std::vector<Match> expected = by_hand(scene, options);
          if (features == 400 && max_distance == 12) {
            EXPECT_GT(expected.size(), 20U);
          }
          testing::for_each_target([&](const std::string& target) {
            expect_same(scene.match(options), expected, target);
          });
        }
      }
    }
  }
}

TEST(MatchWindowed, WithoutOctavesAndTakenFeaturesEqualsTheDefinition) {
  Scene scene = random_scene(400, 300, 4);
  scene.taken.clear();
  scene.min_octaves.clear();
  scene.max_octaves.clear();
  const std::vector<Match> expected = by_hand(scene, {});
  EXPECT_GT(expected.size(), 50U);
  expect_same(scene.match(), expected, "");
  WindowFeatures features = scene.features();
  features.octaves = {};
  std::vector<Match> matches;
  match_windowed(scene.predictions(), features, {}, matches);
  expect_same(matches, expected, "no octaves");
}

TEST(MatchWindowed, EachFeatureGoesToItsNearestPrediction) {
  const Scene scene = random_scene(100, 500, 5);
  const std::vector<Match> matches = scene.match();
  std::vector<int> uses(100, 0);
  for (const Match& m : matches) ++uses[static_cast<std::size_t>(m.train)];
  EXPECT_EQ(*std::max_element(uses.begin(), uses.end()), 1);
  WindowOptions many;
  many.one_to_one = false;
  EXPECT_GT(scene.match(many).size(), matches.size());
}

TEST(MatchWindowed, SkipsPredictionsThatAreNotFiniteOrHaveNoRadius) {
  Scene scene = random_scene(200, 6, 6);
  scene.min_octaves.clear();
  scene.max_octaves.clear();
  scene.radii.assign(6, 500.0F);
  WindowOptions options;
  options.max_distance = 256;
  options.one_to_one = false;
  ASSERT_EQ(scene.match(options).size(), 6U);
  scene.positions[0].x = kNan;
  scene.positions[1].y = kNan;
  scene.positions[2].x = kInfinity;
  scene.radii[3] = kNan;
  scene.radii[4] = 0.0F;
  const std::vector<Match> matches = scene.match(options);
  ASSERT_EQ(matches.size(), 1U);
  EXPECT_EQ(matches[0].query, 5);
  scene.radii[5] = kInfinity;
  EXPECT_TRUE(scene.match(options).empty());
  scene.radii[5] = -1.0F;
  EXPECT_TRUE(scene.match(options).empty());
}

TEST(MatchWindowed, OfNoPredictionsOrNoFeaturesHasNoMatches) {
  Scene no_predictions = random_scene(20, 10, 7);
  no_predictions.positions.clear();
  no_predictions.radii.clear();
  no_predictions.min_octaves.clear();
  no_predictions.max_octaves.clear();
  no_predictions.predicted.release();
  EXPECT_TRUE(no_predictions.match().empty());

  Scene no_features = random_scene(20, 10, 7);
  no_features.keypoints.clear();
  no_features.taken.clear();
  no_features.descriptors.release();
  no_features.grid.build({}, 320, 240);
  EXPECT_TRUE(no_features.match().empty());
}

TEST(MatchWindowed, RefusesSizesThatDisagreeAndLeavesTheOutputAlone) {
  const Scene scene = random_scene(20, 10, 8);
  const std::vector<float> nine_floats(9, 1.0F);
  const std::vector<int> nine_ints(9, 1);
  const std::vector<std::uint8_t> nine_bytes(9, 0);
  const cv::Mat nine_rows = noise(32, 9, 1);
  const cv::Mat wide = noise(33, 10, 1);
  KeypointGrid other_grid;
  other_grid.build(scene.positions, 320, 240);
  std::vector<Match> matches(2);
  const auto refused = [&](const WindowPredictions& predictions, const WindowFeatures& features,
                           const std::string& name) {
    try {
      match_windowed(predictions, features, {}, matches);
      ADD_FAILURE() << name << " was accepted";
    } catch (const InvalidArgument& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
    EXPECT_EQ(matches.size(), 2U);
  };
  WindowPredictions p = scene.predictions();
  p.radii = nine_floats;
  refused(p, scene.features(), "predictions.radii");
  p = scene.predictions();
  p.min_octaves = nine_ints;
  refused(p, scene.features(), "predictions.min_octaves");
  p = scene.predictions();
  p.max_octaves = nine_ints;
  refused(p, scene.features(), "predictions.max_octaves");
  p = scene.predictions();
  p.descriptors = view(nine_rows);
  refused(p, scene.features(), "predictions.descriptors.height");
  p.descriptors = view(wide);
  refused(p, scene.features(), "predictions.descriptors.width");

  WindowFeatures f = scene.features();
  f.grid = nullptr;
  refused(scene.predictions(), f, "features.grid");
  f.grid = &other_grid;
  refused(scene.predictions(), f, "features.grid->size()");
  f = scene.features();
  f.octaves = {};
  refused(scene.predictions(), f, "features.octaves");
  f = scene.features();
  f.octaves = nine_ints;
  refused(scene.predictions(), f, "features.octaves");
  f = scene.features();
  f.taken = nine_bytes;
  refused(scene.predictions(), f, "features.taken");
}

TEST(WindowOptions, MaxDistanceIsNotNegative) {
  WindowOptions options;
  options.max_distance = -1;
  EXPECT_THROW(options.validate(), InvalidArgument);
  EXPECT_THROW(random_scene(3, 3, 1).match(options), InvalidArgument);
}

TEST(WindowOptions, RatioIsInZeroToOne) {
  for (const float bad : {0.0F, -0.5F, 1.01F, kNan}) {
    WindowOptions options;
    options.ratio = bad;
    EXPECT_THROW(options.validate(), InvalidArgument) << bad;
  }
}

}  // namespace
}  // namespace dynslam::features
