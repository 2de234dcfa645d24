// Parsing a long groundtruth.txt and associating long lists, beside what is usually written.
#include <cmath>
#include <cstdio>
#include <sstream>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

#include "dynslam/dataset/parsing.hpp"

namespace {

namespace ds = dynslam::dataset;

constexpr int kRows = 20000;  // of a motion capture system, three minutes

const std::string& truth_text() {
  static const std::string text = [] {
    std::string all = "# timestamp tx ty tz qx qy qz qw\n";
    char row[200];
    for (int i = 0; i < kRows; ++i) {
      const double a = 1e-4 * i;
      std::snprintf(row, sizeof row, "%.4f %.4f %.4f %.4f %.4f %.4f %.4f %.4f\n",
                    1305031098.0 + 0.01 * i, std::sin(a), std::cos(a), a, 0.0, 0.0, std::sin(a / 2),
                    std::cos(a / 2));
      all += row;
    }
    return all;
  }();
  return text;
}

// The rival: lines and numbers through streams, no checks.
std::vector<dynslam::StampedPose> parse_with_streams(const std::string& text) {
  std::vector<dynslam::StampedPose> poses;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream row(line);
    double t, x, y, z, qx, qy, qz, qw;
    row >> t >> x >> y >> z >> qx >> qy >> qz >> qw;
    poses.push_back({t, {Eigen::Quaterniond(qw, qx, qy, qz), Eigen::Vector3d(x, y, z)}});
  }
  return poses;
}

void BM_ParseTruth20000(benchmark::State& state) {
  const auto ours = ds::parse_tum_poses(truth_text(), "f");
  const auto theirs = parse_with_streams(truth_text());
  bool same = ours.size() == theirs.size();
  for (std::size_t i = 0; same && i < ours.size(); ++i) {
    same = ours[i].pose.timestamp == theirs[i].timestamp &&
           ours[i].pose.T_world_cam.R == theirs[i].T_world_cam.R;
  }
  if (!same) state.SkipWithError("other poses than the streams'");
  for (auto _ : state) benchmark::DoNotOptimize(ds::parse_tum_poses(truth_text(), "f").data());
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(truth_text().size()));
}
BENCHMARK(BM_ParseTruth20000)->Unit(benchmark::kMillisecond);

void BM_ParseTruth20000_rival_istringstream(benchmark::State& state) {
  for (auto _ : state) benchmark::DoNotOptimize(parse_with_streams(truth_text()).data());
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(truth_text().size()));
}
BENCHMARK(BM_ParseTruth20000_rival_istringstream)->Unit(benchmark::kMillisecond);

void BM_Associate(benchmark::State& state) {
  const auto n = static_cast<std::size_t>(state.range(0));
  std::vector<double> color(n), depth(n);
  for (std::size_t i = 0; i < n; ++i) {
    color[i] = static_cast<double>(i) / 30.0;
    depth[i] = color[i] + 0.01 * std::sin(static_cast<double>(i));
  }
  if (ds::associate(color, depth, 0.02).size() != n) state.SkipWithError("pairs are missing");
  for (auto _ : state) benchmark::DoNotOptimize(ds::associate(color, depth, 0.02).data());
  state.SetComplexityN(state.range(0));
}
BENCHMARK(BM_Associate)->Arg(1000)->Arg(10000)->Arg(100000)->Unit(benchmark::kMicrosecond);

}  // namespace
