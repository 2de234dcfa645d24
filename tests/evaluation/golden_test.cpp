// Figures from elsewhere: numpy (data/make_golden.py) and published results of known systems.
#include <map>
#include <string>

#include <gtest/gtest.h>

#include "dynslam/evaluation/metrics.hpp"
#include "dynslam/evaluation/trajectory_io.hpp"

#include "evaluation/support.hpp"

namespace dynslam::evaluation {
namespace {

class Golden : public ::testing::Test {
 protected:
  void expect(const std::string& name, const Statistics& s, double tolerance = 1e-8) const {
    const std::pair<const char*, double> members[] = {{"rmse", s.rmse},     {"mean", s.mean},
                                                      {"median", s.median}, {"std", s.std},
                                                      {"min", s.min},       {"max", s.max}};
    for (const auto& [member, value] : members) {
      EXPECT_NEAR(value, golden_.at(name + "." + member), tolerance) << name << "." << member;
    }
    EXPECT_EQ(static_cast<double>(s.count), golden_.at(name + ".count")) << name;
  }

  void expect(const std::string& name, double delta, RpeUnit unit, RpePairs pairs = RpePairs::kAuto,
              RpePath path = RpePath::kEstimate) const {
    RpeOptions options;
    options.delta = delta;
    options.unit = unit;
    options.pairs = pairs;
    options.path = path;
    const RpeResult result = rpe(truth_, estimate_, options);
    expect(name + ".translation", result.translation);
    // numpy took the angle from the cosine, which loses half of the digits near zero.
    expect(name + ".rotation", result.rotation_deg, 1e-5);
  }

  const std::string folder_ = std::string(DYNSLAM_TEST_DATA_DIR) + "/";
  const Trajectory truth_ = read_trajectory(folder_ + "truth.txt");
  const Trajectory estimate_ = read_trajectory(folder_ + "estimate.txt");
  const std::map<std::string, double> golden_ = testing::read_golden();
};

TEST_F(Golden, AbsoluteErrorsAgreeWithNumpy) {
  AteOptions options;
  for (const Alignment kind : {Alignment::kNone, Alignment::kSE3, Alignment::kSim3}) {
    options.alignment = kind;
    const AteResult result = ate(truth_, estimate_, options);
    const std::string name = "ate." + std::string(to_string(kind));
    expect(name, result.error);
    EXPECT_EQ(static_cast<double>(result.pairs.size()), golden_.at("pairs"));
    if (kind != Alignment::kNone) {
      EXPECT_NEAR(result.alignment.truth_from_estimate.scale, golden_.at(name + ".scale"), 1e-10);
    }
  }
}

TEST_F(Golden, RelativeErrorsAgreeWithNumpy) {
  expect("rpe.1f", 1, RpeUnit::kFrames);
  expect("rpe.7f", 7, RpeUnit::kFrames);
  expect("rpe.7f_all", 7, RpeUnit::kFrames, RpePairs::kAll);
  expect("rpe.1s_all", 1, RpeUnit::kSeconds);
  expect("rpe.20m", 20, RpeUnit::kMetres);
  expect("rpe.20m_truth", 20, RpeUnit::kMetres, RpePairs::kConsecutive, RpePath::kTruth);
  expect("rpe.20m_all", 20, RpeUnit::kMetres, RpePairs::kAll);
}

TEST_F(Golden, KittisMetricAgreesWithNumpy) {
  const KittiResult result = kitti_metric(truth_, estimate_);
  EXPECT_NEAR(result.all.translation_percent, golden_.at("kitti.translation"), 1e-9);
  EXPECT_NEAR(result.all.rotation_deg_per_100m, golden_.at("kitti.rotation"), 1e-6);
  EXPECT_EQ(static_cast<double>(result.all.count), golden_.at("kitti.count"));
}

class Published : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(folder_)) GTEST_SKIP() << "no data in " << folder_;
  }
  const std::string folder_ = testing::trajectories_folder();
};

TEST_F(Published, FiguresOfKitti00AreReproduced) {
  const Trajectory truth = read_trajectory(folder_ + "KITTI_00_gt.txt");
  const Trajectory estimate = read_trajectory(folder_ + "KITTI_00_ORB.txt");
  const Statistics absolute = ate(truth, estimate).error;
  EXPECT_NEAR(absolute.rmse, 1.303450, 1e-5);
  EXPECT_NEAR(absolute.mean, 1.156997, 1e-5);
  EXPECT_NEAR(absolute.median, 1.065625, 1e-5);
  EXPECT_NEAR(absolute.std, 0.600282, 1e-5);
  EXPECT_NEAR(absolute.min, 0.069313, 1e-5);
  EXPECT_NEAR(absolute.max, 3.587949, 1e-5);

  RpeOptions options;
  options.delta = 10.0;
  options.unit = RpeUnit::kMetres;
  const Statistics relative = rpe(truth, estimate, options).translation;
  EXPECT_NEAR(relative.rmse, 0.226261, 1e-5);
  EXPECT_NEAR(relative.mean, 0.169017, 1e-5);
  EXPECT_NEAR(relative.median, 0.138484, 1e-5);
  EXPECT_NEAR(relative.max, 1.272209, 1e-5);

  // ORB-SLAM2's paper, table I: 0.70 % and 0.25 degrees per 100 m.
  const KittiResult kitti = kitti_metric(truth, estimate);
  EXPECT_NEAR(kitti.all.translation_percent, 0.70, 0.005);
  EXPECT_NEAR(kitti.all.rotation_deg_per_100m, 0.25, 0.005);
}

TEST_F(Published, ErrorOfFr1XyzIsReproduced) {
  const Trajectory truth = read_trajectory(folder_ + "freiburg1_xyz-groundtruth.txt");
  // The example of TUM's evaluation page: 786 pairs, RMSE 0.013473 m. The second file is the first
  // in another frame.
  for (const char* name : {"freiburg1_xyz-rgbdslam.txt", "freiburg1_xyz-rgbdslam_drift.txt"}) {
    const AteResult result = ate(truth, read_trajectory(folder_ + name));
    EXPECT_EQ(result.pairs.size(), 786u);
    EXPECT_NEAR(result.error.rmse, 0.013473, 1e-5);
  }
}

}  // namespace
}  // namespace dynslam::evaluation
