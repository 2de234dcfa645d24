// Rejects false matches of a made-up pair of images: a camera that moves past boxes, one of which
// moves by itself, and six wrong matches of ten.
#include <cstdint>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "dynslam/core/match.hpp"
#include "dynslam/matching/named_rule.hpp"
#include "dynslam/matching/reject.hpp"

namespace {

/// What a host has: key points of two images, matches between them. And the truth, for once.
struct Scene {
  std::vector<dynslam::matching::Keypoint> points1, points2;
  std::vector<dynslam::Match> matches;
  std::vector<bool> right;
};

Scene make_scene() {
  std::mt19937 random(1);
  const auto uniform = [&](float a, float b) {
    return a + (b - a) * (static_cast<float>(random()) / 4294967296.0F);
  };
  Scene scene;
  for (int i = 0; i < 1000; ++i) {
    dynslam::matching::Keypoint a, b;
    a.x = uniform(0, 640), a.y = uniform(0, 480);
    const bool mover = a.x > 200 && a.x < 330 && a.y > 150 && a.y < 300;
    const float depth = a.y > 300 ? 2.0F : 5.0F;
    b.x = a.x - 525 * 0.2F / depth + uniform(-1, 1);  // 0.2 m to the right, f = 525 px
    b.y = a.y + uniform(-1, 1) + (mover ? 25.0F : 0.0F);
    const bool right = uniform(0, 1) < 0.4F;
    if (!right) b.x = uniform(0, 640), b.y = uniform(0, 480);
    scene.points1.push_back(a);
    scene.points2.push_back(b);
    scene.matches.push_back({i, i, 0.0F});
    scene.right.push_back(right);
  }
  return scene;
}

}  // namespace

int main() {
  const Scene scene = make_scene();
  std::printf("%zu matches, 6 of 10 wrong\n\n%-20s %6s %10s %7s\n", scene.matches.size(), "rule",
              "kept", "precision", "recall");
  dynslam::matching::Workspace workspace;
  for (const auto name : dynslam::matching::kRuleNames) {
    const auto rule = dynslam::matching::make_rule(name);
    std::vector<std::uint8_t> keep(scene.matches.size());
    std::vector<float> weight(scene.matches.size());
    const auto result = dynslam::matching::reject(rule, scene.matches, scene.points1, scene.points2,
                                                  keep, weight, workspace);
    double both = 0, right = 0;
    for (std::size_t i = 0; i < keep.size(); ++i) {
      both += keep[i] != 0 && scene.right[i];
      right += scene.right[i];
    }
    std::printf("%-20s %6zu %10.3f %7.3f\n", std::string(name).c_str(), result.kept,
                both / static_cast<double>(result.kept), both / right);
  }

  // [ten lines]
  std::vector<dynslam::Match> matches = scene.matches;
  std::vector<std::uint8_t> keep(matches.size());
  std::vector<float> weight(matches.size());  // in [0, 1]
  const dynslam::matching::DefaultRule rule;
  dynslam::matching::reject(rule, matches, scene.points1, scene.points2, keep, weight, workspace);

  std::vector<std::int32_t> order(matches.size());  // most trusted first, for PROSAC
  dynslam::matching::prosac_order(weight, order);
  dynslam::matching::erase_rejected(matches, keep);
  // [ten lines]
  std::printf("\nbest match: number %d, weight %.2f; %zu matches remain\n", order[0],
              static_cast<double>(weight[static_cast<std::size_t>(order[0])]), matches.size());
  return 0;
}
