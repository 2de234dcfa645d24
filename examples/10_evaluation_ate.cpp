// Scores an estimated trajectory: a hand-held walk around a room, the same walk as a SLAM system
// might report it, and what the measures say about the difference.
#include <cmath>
#include <cstdio>
#include <random>

#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/report.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

namespace eval = dynslam::evaluation;

namespace {

// Twenty seconds at 100 Hz around a room of 4 m, as a motion capture system would see it.
dynslam::Trajectory make_truth() {
  dynslam::Trajectory truth;
  for (int i = 0; i < 2000; ++i) {
    const double s = i * 2.0 * M_PI / 2000.0;
    const Eigen::Vector3d position(2.0 * std::cos(s), 1.5 * std::sin(s), 0.2 * std::sin(5.0 * s));
    truth.push_back({50.0 + 0.01 * i, {dynslam::so3_exp({0.0, 0.0, s}), position}});
  }
  return truth;
}

// What a system with its own origin reports at 30 Hz: noise, a slow drift, and two lost seconds.
dynslam::Trajectory make_estimate(const dynslam::Trajectory& truth) {
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0.0, 0.003);
  const dynslam::RigidTransform T_map_world(dynslam::so3_exp({0.4, -0.2, 1.0}), {3.0, 1.0, -2.0});
  dynslam::Trajectory estimate;
  for (std::size_t i = 0; i < truth.size(); i += 3) {
    if (i >= 1200 && i < 1400) continue;
    dynslam::RigidTransform T = T_map_world * truth[i].T_world_cam;
    const auto drift = 2e-5 * static_cast<double>(i);
    T.t += Eigen::Vector3d(noise(random), noise(random), noise(random) + drift);
    T.R *= dynslam::so3_exp({noise(random), noise(random), noise(random)});
    estimate.push_back({truth[i].timestamp + 0.002, T});
  }
  return estimate;
}

void print(const char* name, const char* unit, const eval::Statistics& s) {
  std::printf("%-28s %8.4f %8.4f %8.4f %8.4f %8.4f %8.4f %6zu  %s\n", name, s.rmse, s.mean,
              s.median, s.std, s.min, s.max, s.count, unit);
}

}  // namespace

int main() {
  const dynslam::Trajectory truth = make_truth();
  const dynslam::Trajectory estimate = make_estimate(truth);

  eval::write_trajectory("example_estimate.txt", estimate);  // TUM: time tx ty tz qx qy qz qw
  const dynslam::Trajectory read = eval::read_trajectory("example_estimate.txt");

  const eval::AteResult absolute = eval::ate(truth, read);  // associates, aligns by SE(3)
  eval::RpeOptions step;
  step.delta = 1.0;
  step.unit = eval::RpeUnit::kSeconds;
  const eval::RpeResult relative = eval::rpe(truth, read, step);

  std::printf("%zu poses of %zu compared, %.0f %% of the time covered\n\n", absolute.coverage.pairs,
              absolute.coverage.estimate_poses, 100.0 * absolute.coverage.time_share);
  std::printf("%-28s %8s %8s %8s %8s %8s %8s %6s\n", "", "rmse", "mean", "median", "std", "min",
              "max", "count");
  print("ATE", "m", absolute.error);
  print("RPE over 1 s, translation", "m", relative.translation);
  print("RPE over 1 s, rotation", "deg", relative.rotation_deg);

  eval::AteOptions unaligned;
  unaligned.alignment = eval::Alignment::kNone;
  print("ATE without alignment", "m", eval::ate(truth, read, unaligned).error);

  eval::ReportData report;
  report.title = "A walk around a room";
  report.truth = truth;
  report.run.name = "example";
  report.run.estimate = read;
  report.rpe = step;
  const eval::ReportResult written = eval::write_report("example_report.html", report);
  std::printf("\nexample_report.html: %zu plots %s\n", written.plots, written.problem.c_str());
  return absolute.error.rmse < 0.02 ? 0 : 1;
}
