// A long drive (20,000 poses) read, aligned and scored; rivals beside ours in the same run.
#include <cstdio>
#include <cstdlib>
#include <random>
#include <sstream>
#include <string>

#include <Eigen/Geometry>
#include <benchmark/benchmark.h>

#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

namespace {

using namespace dynslam;

constexpr int kPoses = 20000;

Trajectory make_truth() {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  Trajectory truth;
  RigidTransform T;
  for (int i = 0; i < kPoses; ++i) {
    truth.push_back({0.1 * i, T});
    T = (T * RigidTransform{so3_exp({0.0, 0.02 * normal(random), 0.0}), {0.0, 0.0, 0.9}})
            .normalized();
  }
  return truth;
}

Trajectory make_estimate(const Trajectory& truth) {
  std::mt19937 random(2);
  std::normal_distribution<double> normal(0.0, 0.1);
  Trajectory estimate = truth;
  for (StampedPose& pose : estimate) {
    pose.timestamp += 0.004;
    pose.T_world_cam.t += Eigen::Vector3d(normal(random), normal(random), normal(random));
  }
  return estimate;
}

std::string make_text(const Trajectory& trajectory) {
  std::string text;
  char line[300];
  for (const StampedPose& pose : trajectory) {
    const Eigen::Quaterniond q = pose.T_world_cam.quaternion();
    const Eigen::Vector3d& t = pose.T_world_cam.t;
    std::snprintf(line, sizeof line, "%.6f %.7f %.7f %.7f %.7f %.7f %.7f %.7f\n", pose.timestamp,
                  t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
    text += line;
  }
  return text;
}

const Trajectory& truth() {
  static const Trajectory value = make_truth();
  return value;
}
const Trajectory& estimate() {
  static const Trajectory value = make_estimate(truth());
  return value;
}
const std::string& text() {
  static const std::string value = make_text(truth());
  return value;
}

void count_poses(benchmark::State& state) { state.SetItemsProcessed(state.iterations() * kPoses); }

void ReadTum_ours(benchmark::State& state) {
  if (evaluation::parse_trajectory(text(), "text").size() != kPoses) {
    state.SkipWithError("wrong result");
    return;
  }
  for (auto _ : state) benchmark::DoNotOptimize(evaluation::parse_trajectory(text(), "text"));
  count_poses(state);
}

// What most tools do; checks nothing and depends on the locale.
void ReadTum_istream(benchmark::State& state) {
  for (auto _ : state) {
    std::istringstream in(text());
    Trajectory read;
    double v[8];
    while (in >> v[0] >> v[1] >> v[2] >> v[3] >> v[4] >> v[5] >> v[6] >> v[7]) {
      read.push_back({v[0], {Eigen::Quaterniond(v[7], v[4], v[5], v[6]), {v[1], v[2], v[3]}}});
    }
    if (read.size() != kPoses) state.SkipWithError("wrong result");
    benchmark::DoNotOptimize(read);
  }
  count_poses(state);
}

void ReadTum_strtod(benchmark::State& state) {
  for (auto _ : state) {
    Trajectory read;
    const char* at = text().c_str();
    for (;;) {
      double v[8];
      char* end = nullptr;
      for (double& value : v) {
        value = std::strtod(at, &end);
        if (end == at) break;
        at = end;
      }
      if (end == at && *at == '\0') break;
      read.push_back({v[0], {Eigen::Quaterniond(v[7], v[4], v[5], v[6]), {v[1], v[2], v[3]}}});
      while (*at == '\n') ++at;
      if (*at == '\0') break;
    }
    if (read.size() != kPoses) state.SkipWithError("wrong result");
    benchmark::DoNotOptimize(read);
  }
  count_poses(state);
}

Eigen::Matrix3Xd positions(const Trajectory& trajectory) {
  Eigen::Matrix3Xd points(3, static_cast<Eigen::Index>(trajectory.size()));
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    points.col(static_cast<Eigen::Index>(i)) = trajectory[i].T_world_cam.t;
  }
  return points;
}

void AlignSim3_ours(benchmark::State& state) {
  const Eigen::Matrix3Xd a = positions(truth()), b = positions(estimate());
  const auto S = evaluation::align_points(a, b, evaluation::Alignment::kSim3).truth_from_estimate;
  const Eigen::Matrix4d rival = Eigen::umeyama(b, a);
  if ((S.scale * S.T.R - rival.topLeftCorner<3, 3>()).norm() > 1e-9) {
    state.SkipWithError("differs from Eigen::umeyama");
    return;
  }
  for (auto _ : state) {
    benchmark::DoNotOptimize(evaluation::align_points(a, b, evaluation::Alignment::kSim3));
  }
  count_poses(state);
}

void AlignSim3_EigenUmeyama(benchmark::State& state) {
  const Eigen::Matrix3Xd a = positions(truth()), b = positions(estimate());
  for (auto _ : state) benchmark::DoNotOptimize(Eigen::umeyama(b, a).eval());
  count_poses(state);
}

void Associate_ours(benchmark::State& state) {
  if (evaluation::associate(truth(), estimate()).size() != kPoses) {
    state.SkipWithError("wrong result");
    return;
  }
  for (auto _ : state) benchmark::DoNotOptimize(evaluation::associate(truth(), estimate()));
  count_poses(state);
}

void Ate_ours(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(evaluation::ate(truth(), estimate()));
  count_poses(state);
}

void Rpe_ours(benchmark::State& state, evaluation::RpeUnit unit, double delta) {
  evaluation::RpeOptions options;
  options.unit = unit;
  options.delta = delta;
  options.pairs = evaluation::RpePairs::kAll;
  for (auto _ : state) benchmark::DoNotOptimize(evaluation::rpe(truth(), estimate(), options));
  count_poses(state);
}

void Kitti_ours(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(evaluation::kitti_metric(truth(), estimate()));
  count_poses(state);
}

BENCHMARK(ReadTum_ours)->Unit(benchmark::kMillisecond);
BENCHMARK(ReadTum_istream)->Unit(benchmark::kMillisecond);
BENCHMARK(ReadTum_strtod)->Unit(benchmark::kMillisecond);
BENCHMARK(AlignSim3_ours)->Unit(benchmark::kMicrosecond);
BENCHMARK(AlignSim3_EigenUmeyama)->Unit(benchmark::kMicrosecond);
BENCHMARK(Associate_ours)->Unit(benchmark::kMicrosecond);
BENCHMARK(Ate_ours)->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(Rpe_ours, 1_frame, evaluation::RpeUnit::kFrames, 1.0)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Rpe_ours, 1_s_all, evaluation::RpeUnit::kSeconds, 1.0)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(Rpe_ours, 10_m_all, evaluation::RpeUnit::kMetres, 10.0)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(Kitti_ours)->Unit(benchmark::kMillisecond);

}  // namespace
