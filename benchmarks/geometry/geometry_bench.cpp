// Each part is checked once on a scene of known truth, then timed. Sizes: 640 x 480, 1000 features,
// 5 references.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <vector>

#include <benchmark/benchmark.h>

#include "dynslam/geometry/depth_consistency.hpp"
#include "dynslam/geometry/region_grow.hpp"
#include "dynslam/geometry/robust_pose.hpp"
#include "dynslam/geometry/static_memory.hpp"
#include "dynslam/geometry/weighted_constraint.hpp"

namespace {

using namespace dynslam;
using namespace dynslam::geometry;

const PinholeCamera kCamera{525.0, 525.0, 319.5, 239.5, 640, 480};

void check(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "wrong result: %s\n", what);
  std::exit(1);
}

/// 1000 features, a third of which move, in 5 references.
struct FeatureScene {
  static constexpr int kFeatures = 1000, kReferences = 5;
  std::vector<Eigen::Vector2f> now;
  std::vector<float> z_now;
  std::vector<Eigen::Vector2f> then[kReferences];
  std::vector<float> z_then[kReferences];
  std::vector<Match> matches;
  std::vector<ReferenceView> references;
  std::vector<Eigen::Vector3d> world;

  FeatureScene() {
    std::mt19937 generator(1);
    std::normal_distribution<double> noise;
    std::uniform_real_distribution<double> unit;
    for (int i = 0; i < kFeatures; ++i) {
      const Eigen::Vector2d p(40 + 560 * unit(generator), 40 + 400 * unit(generator));
      const double z = 1.0 + 3.0 * unit(generator);
      now.push_back((p + 0.5 * Eigen::Vector2d(noise(generator), noise(generator))).cast<float>());
      z_now.push_back(static_cast<float>(z));
      world.push_back(kCamera.unproject(p, z));
      matches.push_back({i, i, 0.0F});
    }
    for (int r = 0; r < kReferences; ++r) {
      const RigidTransform T_cur_ref(so3_exp({0, 0.01 * r, 0}), {0.05 + 0.03 * r, 0.01, 0});
      for (int i = 0; i < kFeatures; ++i) {
        Eigen::Vector3d X = world[static_cast<std::size_t>(i)];
        if (i % 3 == 0) X += Eigen::Vector3d(0.1 + 0.05 * r, 0.1, 0.0);
        const Eigen::Vector3d Y = T_cur_ref.inverse() * X;
        then[r].push_back(kCamera.project(Y).cast<float>());
        z_then[r].push_back(static_cast<float>(Y.z()));
      }
      ReferenceView view;
      view.T_cur_ref = T_cur_ref;
      view.features.pixels = then[r];
      view.features.depths = z_then[r];
      view.matches = matches;
      references.push_back(view);
    }
  }
};

void weighted_constraint(benchmark::State& state) {
  const FeatureScene scene;
  FeaturesView current;
  current.pixels = scene.now;
  current.depths = scene.z_now;
  std::vector<FeatureVerdict> out(FeatureScene::kFeatures);
  WeightedConstraintWorkspace workspace;
  const auto run = [&] {
    judge_features(kCamera, current, Span<const ReferenceView>(scene.references), {}, workspace,
                   out);
  };
  run();
  int right = 0;
  for (std::size_t i = 0; i < out.size(); ++i) {
    right += out[i].verdict == (i % 3 == 0 ? Verdict::kDynamic : Verdict::kStatic) ? 1 : 0;
  }
  check(right > 980, "weighted_constraint");
  for (auto _ : state) run();
}
BENCHMARK(weighted_constraint)->Unit(benchmark::kMicrosecond);

/// A wall and a floor with a box of 0.8 x 1.2 m at `x`.
std::vector<float> room(double x) {
  std::vector<float> depth(640 * 480);
  for (int v = 0; v < 480; ++v) {
    for (int u = 0; u < 640; ++u) {
      const Eigen::Vector3d d = kCamera.bearing({double(u), double(v)});
      double z = d.y() > 0.0 ? std::min(3.0, 1.0 / d.y()) : 3.0;
      const Eigen::Vector3d hit = 1.6 * d;
      if (std::abs(hit.x() - x) < 0.4 && std::abs(hit.y() - 0.1) < 0.6) z = 1.6;
      depth[static_cast<std::size_t>(v * 640 + u)] = static_cast<float>(z);
    }
  }
  return depth;
}

struct DepthScene {
  std::vector<float> now = room(0.5);
  DepthCells cells[5];
  std::vector<DepthReference> references;
  DepthEvidence evidence;

  DepthScene() {
    for (int r = 0; r < 5; ++r) {
      const auto then = room(-0.6 + 0.05 * r);
      build_depth_cells({then.data(), 640, 480}, kCamera, {}, cells[r]);
      references.push_back({{}, &cells[r], 1.0});
    }
  }
  void judge() {
    judge_depth({now.data(), 640, 480}, kCamera, Span<const DepthReference>(references), {},
                evidence);
  }
};

void depth_cells(benchmark::State& state) {
  const auto image = room(0.0);
  DepthCells cells;
  for (auto _ : state) build_depth_cells({image.data(), 640, 480}, kCamera, {}, cells);
  check(cells.near_depth[60 * 160 + 80] == 1.6F, "depth_cells");
}
BENCHMARK(depth_cells)->Unit(benchmark::kMicrosecond);

void depth_consistency(benchmark::State& state) {
  DepthScene scene;
  scene.judge();
  check(std::abs(scene.evidence.dynamic_cells - 6400) < 400, "depth_consistency");
  for (auto _ : state) scene.judge();
}
BENCHMARK(depth_consistency)->Unit(benchmark::kMicrosecond);

void cell_memory(benchmark::State& state) {
  DepthScene scene;
  scene.judge();
  CellMemory memory;
  double time = 0.0;
  for (auto _ : state) {
    memory.update(kCamera, {}, time, 0.6, scene.evidence);
    time += 0.03;
  }
}
BENCHMARK(cell_memory)->Unit(benchmark::kMicrosecond);

void region_grow(benchmark::State& state) {
  DepthScene scene;
  scene.judge();
  std::vector<std::uint8_t> mask(640 * 480);
  RegionGrowWorkspace workspace;
  const auto run = [&] {
    return grow_regions({scene.now.data(), 640, 480}, scene.evidence, {}, {}, {}, workspace,
                        {mask.data(), 640, 480});
  };
  const double share = run();
  check(share > 0.28 && share < 0.38, "region_grow");
  for (auto _ : state) benchmark::DoNotOptimize(run());
}
BENCHMARK(region_grow)->Unit(benchmark::kMicrosecond);

void robust_pose(benchmark::State& state) {
  // Half of 500 points move, a fifth of all are wrong.
  FeatureScene scene;
  const RigidTransform T(so3_exp({0.02, 0.05, 0}), {0.1, 0, 0.05});
  std::mt19937 generator(2);
  std::uniform_real_distribution<double> unit;
  std::vector<Eigen::Vector3d> world(scene.world.begin(), scene.world.begin() + 500);
  std::vector<Eigen::Vector2f> pixels;
  std::vector<float> depths;
  for (std::size_t i = 0; i < world.size(); ++i) {
    Eigen::Vector3d X = world[i];
    if (i % 2 == 0) X += Eigen::Vector3d(0.2, 0.05, 0);
    X = T * X;
    if (i % 5 == 0) X += Eigen::Vector3d(unit(generator), unit(generator), unit(generator));
    pixels.push_back(kCamera.project(X).cast<float>());
    depths.push_back(static_cast<float>(X.z()));
  }
  PoseProblem problem;
  problem.world = world;
  problem.pixels = pixels;
  problem.depths = depths;
  PosePrior prior;
  prior.T_cam_world = se3_exp((Vector6d() << 0.02, 0, 0, 0, 0.01, 0).finished()) * T;
  RobustPoseWorkspace workspace;
  RobustPoseResult result;
  const auto run = [&] { estimate_pose(kCamera, problem, &prior, {}, {}, workspace, result); };
  run();
  check(result.ok() && (result.T_cam_world.t - T.t).norm() < 1e-3, "robust_pose");
  for (auto _ : state) run();
}
BENCHMARK(robust_pose)->Unit(benchmark::kMicrosecond);

}  // namespace
