#include <cmath>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/dataset/readers.hpp"

#include "dataset/tiny_folders.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;
using testing::holds;
using testing::invalid_argument_of;
using testing::io_error_of;
using testing::TempFolder;
using testing::write_image;
using testing::write_text;

// A pair as on a drone: cameras turned against the body and a little against each other.
struct Rig {
  cv::Matx33d K[2] = {{458.6, 0, 367.2, 0, 457.3, 248.4, 0, 0, 1},
                      {457.6, 0, 380.0, 0, 456.1, 255.2, 0, 0, 1}};
  std::vector<double> d[2] = {{-0.2834, 0.0740, 0.0002, 0.0000},
                              {-0.2837, 0.0745, -0.0001, -0.0000}};
  RigidTransform T_body_cam[2];

  Rig() {
    Vector6d left, between;
    left << 0.02, -0.06, 0.01, 0.02, -0.03, 1.55;
    between << 0.11, 0.001, -0.002, 0.01, -0.015, 0.02;
    T_body_cam[0] = se3_exp(left);
    T_body_cam[1] = T_body_cam[0] * se3_exp(between);
  }

  std::string yaml(int camera) const {
    const Eigen::Matrix4d m = T_body_cam[camera].matrix();
    std::ostringstream text;
    text.precision(12);
    text << "# sensor\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [";
    for (int i = 0; i < 16; ++i)
      text << m(i / 4, i % 4) << (i < 15 ? (i % 4 == 3 ? ",\n  " : ", ") : "]\n");
    const cv::Matx33d& k = K[camera];
    text << "rate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [" << k(0, 0)
         << ", " << k(1, 1) << ", " << k(0, 2) << ", " << k(1, 2)
         << "] #fu\ndistortion_model: radial-tangential\ndistortion_coefficients: [" << d[camera][0]
         << ", " << d[camera][1] << ", " << d[camera][2] << ", " << d[camera][3] << "]\n";
    return text.str();
  }

  // A bright dot where the camera sees the point.
  cv::Mat photograph(int camera, const RigidTransform& T_world_body,
                     const Eigen::Vector3d& X_world) const {
    const Eigen::Vector3d X = (T_world_body * T_body_cam[camera]).inverse() * X_world;
    std::vector<cv::Point2d> seen;
    cv::projectPoints(std::vector<cv::Point3d>{{X.x(), X.y(), X.z()}}, cv::Vec3d(), cv::Vec3d(),
                      K[camera], d[camera], seen);
    cv::Mat image(480, 752, CV_8UC1, cv::Scalar(0));
    for (int y = 0; y < image.rows; ++y) {
      for (int x = 0; x < image.cols; ++x) {
        const double r2 = std::pow(x - seen[0].x, 2) + std::pow(y - seen[0].y, 2);
        image.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(250.0 * std::exp(-r2 / 18.0));
      }
    }
    return image;
  }
};

const Eigen::Vector3d kPoint(0.5, 0.3, 4.0);

RigidTransform T_world_body() {
  Vector6d xi;
  xi << 0.1, 0.2, -0.1, 0.05, -0.04, -1.5;
  return se3_exp(xi);
}

void write_euroc(const fs::path& folder, const Rig& rig) {
  for (int camera = 0; camera < 2; ++camera) {
    const fs::path cam = folder / ("mav0/cam" + std::to_string(camera));
    write_text(cam / "sensor.yaml", rig.yaml(camera));
    write_text(cam / "data.csv",
               "#timestamp [ns],filename\r\n1000000000,1000000000.png\r\n1050000000,b.png\r\n");
    write_image(cam / "data/1000000000.png", rig.photograph(camera, T_world_body(), kPoint));
  }
  const Eigen::Quaterniond q = T_world_body().quaternion();
  const Eigen::Vector3d t = T_world_body().t;
  std::ostringstream truth;
  truth.precision(15);
  truth << "#timestamp, p_RS_R_x [m], ...\n1000000000," << t.x() << "," << t.y() << "," << t.z()
        << "," << q.w() << "," << q.x() << "," << q.y() << "," << q.z() << ",0,0,0\n";
  write_text(folder / "mav0/state_groundtruth_estimate0/data.csv", truth.str());
}

cv::Point2d dot(const cv::Mat& image) {
  const cv::Moments m = cv::moments(image);
  return {m.m10 / m.m00, m.m01 / m.m00};
}

TEST(OpenEuroc, RectifiesAPairSoThatCameraTruthAndBaselineAgree) {
  TempFolder folder;
  write_euroc(folder.path(), Rig());
  const auto sequence = open_euroc(folder.path());
  EXPECT_EQ(sequence->sensor(), SensorKind::kStereo);
  EXPECT_EQ(sequence->size(), 2U);
  EXPECT_EQ(sequence->fps(), 20.0);
  const Rig rig;
  EXPECT_NEAR(sequence->camera().baseline(), (rig.T_body_cam[1].t - rig.T_body_cam[0].t).norm(),
              1e-6);
  const Frame frame = sequence->read(0);
  const Eigen::Vector3d X = frame.T_world_cam->inverse() * kPoint;
  const Eigen::Vector3d expected = sequence->camera().project3(X);
  const cv::Point2d left = dot(frame.color), right = dot(frame.right);
  EXPECT_NEAR(left.x, expected(0), 0.05);
  EXPECT_NEAR(left.y, expected(1), 0.05);
  EXPECT_NEAR(right.x, expected(2), 0.05);
  EXPECT_NEAR(right.y, left.y, 0.05);
}

TEST(OpenEuroc, UndistortsTheLeftCameraAlone) {
  TempFolder folder;
  write_euroc(folder.path(), Rig());
  EurocOptions options;
  options.left_only = true;
  const auto sequence = open_euroc(folder / "mav0", options);
  EXPECT_EQ(sequence->name(), folder.path().filename().string());
  EXPECT_EQ(sequence->sensor(), SensorKind::kMono);
  EXPECT_EQ(sequence->camera().fx, 458.6);
  const Frame frame = sequence->read(0);
  EXPECT_TRUE(frame.right.empty());
  const Eigen::Vector2d expected =
      sequence->camera().project(frame.T_world_cam->inverse() * kPoint);
  EXPECT_NEAR(dot(frame.color).x, expected.x(), 0.05);
  EXPECT_NEAR(dot(frame.color).y, expected.y(), 0.05);
}

TEST(OpenEuroc, LeavesOutLeftImagesWithoutARightOne) {
  TempFolder folder;
  write_euroc(folder.path(), Rig());
  write_text(folder / "mav0/cam1/data.csv", "1000100000,1000000000.png\n");
  const auto sequence = open_euroc(folder.path());
  EXPECT_EQ(sequence->size(), 1U);
  EXPECT_EQ(sequence->report().unmatched_frames, 1U);
  write_text(folder / "mav0/cam1/data.csv", "9000100000,1000000000.png\n");
  EXPECT_TRUE(holds(io_error_of([&] { open_euroc(folder.path()); }), "no image of cam0 has one"));
}

TEST(OpenEuroc, RefusesWhatIsMissingOrWrong) {
  TempFolder folder;
  const Rig rig;
  const auto error = [&] { return io_error_of([&] { open_euroc(folder.path()); }); };
  EXPECT_TRUE(holds(error(), "cam0/sensor.yaml: there is no such file"));
  write_euroc(folder.path(), rig);
  write_text(folder / "mav0/cam0/data.csv", "#none\n");
  EXPECT_TRUE(holds(error(), "cam0/data.csv: there are no images"));
  write_text(folder / "mav0/cam0/data.csv", "2,a.png\n1,b.png\n");
  EXPECT_TRUE(holds(error(), "cam0/data.csv:2: the time goes back"));
  write_euroc(folder.path(), rig);
  write_text(folder / "mav0/state_groundtruth_estimate0/data.csv", "#\n");
  EXPECT_TRUE(holds(error(), "there are no poses"));
}

TEST(OpenEuroc, RefusesCamerasThatAreNoLeftAndRightPair) {
  TempFolder folder;
  const Rig rig;
  write_euroc(folder.path(), rig);
  const auto error_with = [&](const std::string& left, std::string right) {
    write_text(folder / "mav0/cam0/sensor.yaml", left);
    write_text(folder / "mav0/cam1/sensor.yaml", right);
    return io_error_of([&] { open_euroc(folder.path()); });
  };
  EXPECT_TRUE(holds(error_with(rig.yaml(0), rig.yaml(0)), "cam1 is where cam0 is"));
  EXPECT_TRUE(holds(error_with(rig.yaml(1), rig.yaml(0)), "cam1 is not to the right of cam0"));
  std::string small = rig.yaml(1);
  small.replace(small.find("752"), 3, "640");
  EXPECT_TRUE(holds(error_with(rig.yaml(0), small), "the resolution is not that of cam0"));
}

TEST(EurocOptions, RefuseEachValueThatBreaksItsRule) {
  EXPECT_NO_THROW(EurocOptions().validate());
  EurocOptions difference, gap;
  difference.max_time_difference = -0.1;
  gap.max_truth_gap = std::nan("");
  EXPECT_TRUE(holds(invalid_argument_of([&] { difference.validate(); }), "max_time_difference"));
  EXPECT_TRUE(holds(invalid_argument_of([&] { gap.validate(); }), "max_truth_gap"));
}

}  // namespace
}  // namespace dynslam::dataset
