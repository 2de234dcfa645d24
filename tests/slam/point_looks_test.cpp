#include "slam/point_looks.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/so3.hpp"
#include "dynslam/dataset/scene.hpp"

#include "slam/frame_builder.hpp"
#include "slam/median.hpp"

namespace dynslam::slam {
namespace {

// Two frames of a still room. Features of the first are points of the map, with looks; where they
// are in the second is known exactly.
class PointLooks : public ::testing::Test {
 protected:
  void SetUp() override {
    dataset::SceneOptions options;
    options.movers = false;
    rendered_ = std::make_unique<dataset::RenderedScene>(options);
    camera_ = rendered_->camera();
    builder_ = std::make_unique<FrameBuilder>(camera_, SystemOptions());
    TrackedFrame first;
    build(kFirst, first);
    make_points(first);
    first_ = first.features;
    look_again(kFirst + 10);
  }

  void look_again(std::size_t index) {
    second_index_ = index;
    build(index, second_);
    matches_.clear();
    truths_.clear();
    match(*first_);
  }

  void build(std::size_t index, TrackedFrame& frame) {
    const dataset::Frame image = rendered_->render(index);
    FrameInput input;
    input.timestamp = image.timestamp;
    input.image = image.color;
    input.depth = image.depth;
    frame.depth = image.depth;
    frame.reset(builder_->build(input, {}), input.timestamp);
    builder_->view_levels(frame.levels);
    frame.T_cam_world = rendered_->T_world_cam(index).inverse();
  }

  void make_points(const TrackedFrame& frame) {
    const cv::Mat depth = rendered_->exact_depth(kFirst);
    for (std::size_t i = 0; i < frame.features->size(); ++i) {
      const cv::Point2f pt = frame.features->keypoints[i].pt;
      const auto z = static_cast<double>(depth.at<float>(cvRound(pt.y), cvRound(pt.x)));
      MapPoint point;
      point.position = frame.T_cam_world.inverse() * camera_.unproject({pt.x, pt.y}, z);
      point.look = point_look(camera_, frame, i, point.position, builder_->scale_factors());
      ASSERT_NE(point.look, nullptr);
      ids_.push_back(map_.add_point(std::move(point)));
    }
  }

  // With the corner of the same level that lies nearest to where the point is.
  void match(const FrameFeatures& first) {
    const FrameFeatures& second = *second_.features;
    for (std::size_t i = 0; i < first.size(); ++i) {
      const cv::KeyPoint& from = first.keypoints[i];
      const auto truth = rendered_->correspondence(kFirst, {from.pt.x, from.pt.y}, second_index_);
      if (!truth || !truth->visible) continue;
      double least = 1.0;
      PointMatch match{0, 0, Eigen::Vector3d::Zero(), 1.0F};
      for (std::uint32_t j = 0; j < second.size(); ++j) {
        const cv::KeyPoint& to = second.keypoints[j];
        const double off = std::hypot(static_cast<double>(to.pt.x) - truth->pixel.x(),
                                      static_cast<double>(to.pt.y) - truth->pixel.y()) /
                           static_cast<double>(scale_of(to));
        if (to.octave != from.octave || off >= least) continue;
        least = off;
        match.feature = j;
      }
      if (least >= 1.0) continue;
      match.source = static_cast<std::uint32_t>(i);
      matches_.push_back(match);
      truths_.push_back(truth->pixel);
    }
    ASSERT_GT(matches_.size(), 300U);
  }

  float scale_of(const cv::KeyPoint& keypoint) const {
    return builder_->scale_factors()[static_cast<std::size_t>(keypoint.octave)];
  }

  double error_of(const cv::KeyPoint& keypoint, const Eigen::Vector2d& truth) const {
    return std::hypot(static_cast<double>(keypoint.pt.x) - truth.x(),
                      static_cast<double>(keypoint.pt.y) - truth.y()) /
           static_cast<double>(scale_of(keypoint));
  }

  // Pixels of the level that the key points of matches are off.
  double median_error() const {
    std::vector<double> errors;
    for (std::size_t k = 0; k < matches_.size(); ++k) {
      errors.push_back(error_of(second_.features->keypoints[matches_[k].feature], truths_[k]));
    }
    return median(errors);
  }

  int align() { return finder().align(map_, matches_, ids_, second_); }

  LookFinder finder() const { return {camera_, builder_->scale_factors()}; }

  // All points of the map, as from a place that is hardly another.
  std::vector<SoughtPoint> all_points() const {
    std::vector<SoughtPoint> sought;
    for (std::uint32_t i = 0; i < ids_.size(); ++i) {
      sought.push_back({i, ids_[i], first_->keypoints[i].octave, 1});
    }
    return sought;
  }

  // Pixels of the level that a point found is off, if it is visible at all.
  std::optional<double> error_of(const PointMatch& found) const {
    const cv::Point2f from = first_->keypoints[found.source].pt;
    const auto truth = rendered_->correspondence(kFirst, {from.x, from.y}, second_index_);
    if (!truth || !truth->visible) return std::nullopt;
    return error_of(second_.features->keypoints[found.feature], truth->pixel);
  }

  static constexpr std::size_t kFirst = 40, kAll = 100000;
  std::size_t second_index_ = 0;
  std::unique_ptr<dataset::RenderedScene> rendered_;
  DepthCamera camera_;
  std::unique_ptr<FrameBuilder> builder_;
  Map map_;
  std::vector<PointId> ids_;
  FrameFeaturesPtr first_;
  TrackedFrame second_;
  std::vector<PointMatch> matches_;
  std::vector<Eigen::Vector2d> truths_;
};

TEST_F(PointLooks, TellWhereAPointIsToATenthOfAPixel) {
  const double corners = median_error();
  const int aligned = align();
  EXPECT_GT(aligned, static_cast<int>(matches_.size()) * 7 / 10);
  EXPECT_LT(median_error(), 0.1);
  EXPECT_LT(median_error(), 0.5 * corners);
}

TEST_F(PointLooks, MoveRightColumnsAlongAndLeaveTheSharedFeatures) {
  const FrameFeaturesPtr before = second_.features;
  const std::vector<cv::KeyPoint> keypoints = before->keypoints;
  ASSERT_GT(align(), 0);
  ASSERT_NE(second_.features, before);
  int moved = 0;
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    EXPECT_EQ(before->keypoints[i].pt, keypoints[i].pt);
    const cv::KeyPoint& now = second_.features->keypoints[i];
    const cv::Point2f step = now.pt - keypoints[i].pt;
    EXPECT_LE(cv::norm(step), 4.01 * static_cast<double>(scale_of(now)));
    moved += step != cv::Point2f();
    if (!(before->depths[i] > 0.0F)) continue;
    const float shift = second_.features->right_columns[i] - before->right_columns[i];
    EXPECT_NEAR(shift, step.x, 1e-3);
  }
  EXPECT_GT(moved, static_cast<int>(matches_.size()) / 2);
}

TEST_F(PointLooks, AreNotUsedFromAside) {
  // As if the looks were from where lines of sight are 20 degrees off, to the right.
  const Eigen::Matrix3d R_cam_world = second_.T_cam_world.R;
  const Eigen::Matrix3d turn = R_cam_world.transpose() * so3_exp({0.0, 0.35, 0.0}) * R_cam_world;
  for (const PointId id : ids_) {
    auto aside = std::make_shared<PointLook>(*map_.point(id).look);
    aside->camera_point_world = turn * aside->camera_point_world;
    aside->R_cam_world = aside->R_cam_world * turn.transpose();
    map_.point(id).look = aside;
  }
  EXPECT_EQ(align(), 0);
}

TEST_F(PointLooks, NeedThePyramidAndThePoint) {
  const FrameFeaturesPtr before = second_.features;
  map_.point(ids_[matches_[0].source]).look = nullptr;
  for (std::size_t i = 1; i < ids_.size() / 2; ++i) map_.erase_point(ids_[i]);
  EXPECT_GT(align(), 0);
  second_.features = before;
  second_.levels.clear();
  EXPECT_EQ(align(), 0);
  EXPECT_EQ(second_.features, before);
  EXPECT_EQ(point_look(camera_, second_, 0, {0.0, 0.0, 2.0}, builder_->scale_factors()), nullptr);
}

TEST_F(PointLooks, AreFoundBesideTheWrongCorner) {
  align();
  const double before = median_error();
  // Two pixels of the level beside: another corner than the point's.
  auto features = std::make_shared<FrameFeatures>(*second_.features);
  for (const PointMatch& match : matches_) {
    cv::KeyPoint& keypoint = features->keypoints[match.feature];
    keypoint.pt.x += 2.0F * scale_of(keypoint);
  }
  second_.features = features;
  EXPECT_GT(align(), static_cast<int>(matches_.size()) * 7 / 10);
  EXPECT_LT(median_error(), 1.1 * before + 0.01);
}

TEST_F(PointLooks, FindPointsWithoutACorner) {
  const std::size_t corners = second_.features->size();
  const FrameFeaturesPtr before = second_.features;
  const std::vector<PointMatch> found = finder().seek(map_, all_points(), kAll, second_);
  ASSERT_GT(found.size(), ids_.size() / 2);
  ASSERT_EQ(second_.features->size(), corners + found.size());
  EXPECT_EQ(second_.features->grid.size(), corners + found.size());
  EXPECT_EQ(second_.features->descriptors.rows, static_cast<int>(corners + found.size()));
  EXPECT_EQ(second_.points.size(), corners + found.size());
  EXPECT_EQ(before->size(), corners) << "features are shared";
  std::vector<double> errors;
  for (const PointMatch& match : found) {
    EXPECT_GE(match.feature, corners);
    EXPECT_GT(second_.features->depths[match.feature], 0.0F);
    if (const auto error = error_of(match)) errors.push_back(*error);
  }
  EXPECT_GT(errors.size(), found.size() * 98 / 100) << "what is hidden is not found";
  EXPECT_LT(median(errors), 0.1);
  second_.drop_sought();
  EXPECT_EQ(second_.features, before);
  EXPECT_EQ(second_.points.size(), corners);
}

TEST_F(PointLooks, AreSoughtOnlyWhereThingsAreBelievedToStandStill) {
  const cv::Size cells = second_.depth.size() / kSurfaceCell;
  second_.cell_trust = cv::Mat(cells, CV_32FC1, cv::Scalar(0.5));
  const int middle = cells.width / 2;
  second_.cell_trust.colRange(0, middle).setTo(0.0F);
  const std::vector<PointMatch> found = finder().seek(map_, all_points(), kAll, second_);
  ASSERT_GT(found.size(), ids_.size() / 8);
  for (const PointMatch& match : found) {
    const cv::KeyPoint& keypoint = second_.features->keypoints[match.feature];
    EXPECT_GE(cvRound(keypoint.pt.x), kSurfaceCell * middle);
  }
}

TEST_F(PointLooks, AreNotSoughtWhereDepthIsAnothersOrMissing) {
  const std::size_t corners = second_.features->size();
  second_.depth *= 0.8;
  EXPECT_TRUE(finder().seek(map_, all_points(), kAll, second_).empty());
  second_.depth.setTo(std::numeric_limits<float>::quiet_NaN());
  EXPECT_TRUE(finder().seek(map_, all_points(), kAll, second_).empty());
  second_.depth.setTo(0.0F);  // as under a mask
  EXPECT_TRUE(finder().seek(map_, all_points(), kAll, second_).empty());
  second_.depth.release();
  EXPECT_TRUE(finder().seek(map_, all_points(), kAll, second_).empty());
  EXPECT_EQ(second_.features->size(), corners);
  EXPECT_EQ(second_.corners, nullptr);
}

}  // namespace
}  // namespace dynslam::slam
