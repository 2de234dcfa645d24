#include "dynslam/matching/opencv.hpp"

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/span.hpp"
#include "dynslam/matching/motion_consensus.hpp"
#include "dynslam/matching/reject.hpp"
#include "dynslam/matching/rules.hpp"

#include "matching/synthetic_pairs.hpp"

namespace {

namespace dm = dynslam::matching;

TEST(OpenCvMatches, AreRejectedAsOurs) {
  synthetic::Setup setup;
  setup.camera.rotation = synthetic::turn(0, 0, 90);
  setup.camera.roll_degrees = 90;
  const synthetic::Pairs pairs = synthetic::make_pairs(setup);
  std::vector<cv::KeyPoint> keypoints1, keypoints2;
  std::vector<cv::DMatch> matches;
  for (std::size_t i = 0; i < pairs.matches.size(); ++i) {
    const dm::Keypoint& a = pairs.points1[i];
    const dm::Keypoint& b = pairs.points2[i];
    keypoints1.emplace_back(a.x, a.y, a.size, a.angle);
    keypoints2.emplace_back(b.x, b.y, b.size, b.angle);
    matches.emplace_back(static_cast<int>(i), static_cast<int>(i), pairs.matches[i].distance);
  }
  std::vector<std::uint8_t> ours(matches.size()), theirs(matches.size()), points(matches.size());
  std::vector<float> our_weight(matches.size()), their_weight(matches.size());
  dm::Workspace workspace;
  dm::reject(dm::DefaultRule(), pairs.matches, pairs.points1, pairs.points2, ours, our_weight,
             workspace);
  dm::reject(dm::DefaultRule(), matches, keypoints1, keypoints2, theirs, their_weight, workspace);
  EXPECT_EQ(theirs, ours);
  EXPECT_EQ(their_weight, our_weight);
  // A view of the points alone binds as well; the roll is then found without the angles.
  dm::reject(dm::DefaultRule(), matches, dynslam::field(keypoints1, &cv::KeyPoint::pt),
             dynslam::field(keypoints2, &cv::KeyPoint::pt), points, {}, workspace);
  EXPECT_GE(synthetic::score(points, pairs.good).recall, 0.9);
}

TEST(OpenCvKeyPoint, WithoutAngleHasNone) {
  const cv::KeyPoint keypoint(1.0F, 2.0F, 31.0F);
  EXPECT_TRUE(std::isnan(dm::KeypointTraits<cv::KeyPoint>::get(keypoint).angle));
}

/// Frames i and i + 3 of KITTI 06 with their raw 1-NN ORB matches.
struct RealPair {
  std::vector<cv::KeyPoint> keypoints1, keypoints2;
  std::vector<cv::DMatch> matches;
  std::vector<std::uint8_t> good;
};

std::string kitti_folder() {
  const char* folder = std::getenv("DYNSLAM_DATA");
  return std::string(folder != nullptr ? folder : DYNSLAM_DEFAULT_DATA_DIR) + "/kitti_06_start";
}

std::vector<cv::Matx34d> read_poses(const std::string& path) {
  std::vector<cv::Matx34d> poses;
  std::ifstream file(path);
  cv::Matx34d pose;
  while (file >> pose.val[0]) {
    for (int i = 1; i < 12; ++i) file >> pose.val[i];
    poses.push_back(pose);
  }
  return poses;
}

RealPair make_real_pair(int first, const std::vector<cv::Matx34d>& poses) {
  RealPair pair;
  const auto detector = cv::ORB::create(1000);
  cv::Mat descriptors1, descriptors2;
  const auto image = [&](int i) {
    return cv::imread(cv::format("%s/image_0/%06d.png", kitti_folder().c_str(), i),
                      cv::IMREAD_GRAYSCALE);
  };
  detector->detectAndCompute(image(first), {}, pair.keypoints1, descriptors1);
  detector->detectAndCompute(image(first + 3), {}, pair.keypoints2, descriptors2);
  cv::BFMatcher(cv::NORM_HAMMING).match(descriptors1, descriptors2, pair.matches);
  const cv::Matx33d k(707.0912, 0, 601.8873, 0, 707.0912, 183.1104, 0, 0, 1);
  const cv::Matx34d& a = poses[static_cast<std::size_t>(first)];
  const cv::Matx34d& b = poses[static_cast<std::size_t>(first) + 3];
  const cv::Matx33d rotation1 = a.get_minor<3, 3>(0, 0), rotation2 = b.get_minor<3, 3>(0, 0);
  const cv::Vec3d t =
      rotation2.t() * cv::Vec3d(a(0, 3) - b(0, 3), a(1, 3) - b(1, 3), a(2, 3) - b(2, 3));
  const cv::Matx33d cross(0, -t[2], t[1], t[2], 0, -t[0], -t[1], t[0], 0);
  const cv::Matx33d f = k.inv().t() * cross * rotation2.t() * rotation1 * k.inv();
  for (const cv::DMatch& match : pair.matches) {
    const cv::Point2f p = pair.keypoints1[static_cast<std::size_t>(match.queryIdx)].pt;
    const cv::Point2f q = pair.keypoints2[static_cast<std::size_t>(match.trainIdx)].pt;
    const cv::Vec3d line2 = f * cv::Vec3d(p.x, p.y, 1), line1 = f.t() * cv::Vec3d(q.x, q.y, 1);
    const double e = std::abs(line2.dot(cv::Vec3d(q.x, q.y, 1)));
    pair.good.push_back(e < 2 * std::hypot(line2[0], line2[1]) &&
                        e < 2 * std::hypot(line1[0], line1[1]));
  }
  return pair;
}

TEST(MotionConsensus, BeatsMagsacAndTheModalBinOnRealPairs) {
  const std::vector<cv::Matx34d> poses = read_poses(kitti_folder() + "/poses.txt");
  if (poses.size() < 45) GTEST_SKIP() << "no KITTI images in " << kitti_folder();
  const auto f1 = [](const synthetic::Score& s) {
    return s.precision + s.recall > 0 ? 2 * s.precision * s.recall / (s.precision + s.recall) : 0.0;
  };
  dm::Workspace workspace(1000);
  double ours = 0, theirs = 0, modals = 0;
  for (int first = 0; first <= 40; first += 8) {
    const RealPair pair = make_real_pair(first, poses);
    std::vector<std::uint8_t> keep(pair.matches.size()), modal(pair.matches.size());
    dm::reject(dm::DefaultRule(), pair.matches, pair.keypoints1, pair.keypoints2, keep, {},
               workspace);
    dm::reject(dm::ModalBin(), pair.matches, pair.keypoints1, pair.keypoints2, modal, {},
               workspace);
    std::vector<cv::Point2f> points1, points2;
    for (const cv::DMatch& match : pair.matches) {
      points1.push_back(pair.keypoints1[static_cast<std::size_t>(match.queryIdx)].pt);
      points2.push_back(pair.keypoints2[static_cast<std::size_t>(match.trainIdx)].pt);
    }
    std::vector<std::uint8_t> mask;
    cv::findFundamentalMat(points1, points2, cv::USAC_MAGSAC, 2.0, 0.999, 1000, mask);
    mask.resize(pair.matches.size());
    ours += f1(synthetic::score(keep, pair.good));
    theirs += f1(synthetic::score(mask, pair.good));
    modals += f1(synthetic::score(modal, pair.good));
  }
  EXPECT_GE(ours, theirs);
  EXPECT_GE(ours, 1.2 * modals);
}

}  // namespace
