#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>

#include <Eigen/Core>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/scene.hpp"

#include "dataset/scene_testing.hpp"
#include "sanitized.hpp"

namespace dynslam::dataset {
namespace {

/// Depth at a sub-pixel place of an exact depth image if the pixels around it are one static plane,
/// on which inverse depth is linear; 0 otherwise.
double plane_depth(const SceneTruth& truth, const Eigen::Vector2d& p) {
  const int x = static_cast<int>(std::floor(p.x())), y = static_cast<int>(std::floor(p.y()));
  if (x < 1 || y < 1 || x + 1 >= truth.depth.cols || y + 1 >= truth.depth.rows) return 0.0;
  if (truth.mask.at<std::uint8_t>(y, x) != kStaticLabel) return 0.0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      if (truth.surface.at<std::uint16_t>(y + dy, x + dx) !=
          truth.surface.at<std::uint16_t>(y, x)) {
        return 0.0;
      }
    }
  }
  const auto w = [&](int dx, int dy) {
    return 1.0 / static_cast<double>(truth.depth.at<float>(y + dy, x + dx));
  };
  const double bend_x = std::abs(w(-1, 0) + w(1, 0) - 2.0 * w(0, 0));
  const double bend_y = std::abs(w(0, -1) + w(0, 1) - 2.0 * w(0, 0));
  if (bend_x > 1e-6 || bend_y > 1e-6) return 0.0;
  const double fx = p.x() - x, fy = p.y() - y;
  return 1.0 / ((1 - fy) * ((1 - fx) * w(0, 0) + fx * w(1, 0)) +
                fy * ((1 - fx) * w(0, 1) + fx * w(1, 1)));
}

TEST(RenderedScene, DepthOfOneFrameProjectsOntoTheDepthOfAnotherOnStaticPixels) {
  const RenderedScene scene(small(3, 320, 240));
  for (const auto& [from, to] : {std::pair(60, 70), std::pair(200, 230), std::pair(231, 229)}) {
    const auto i = static_cast<std::size_t>(from), j = static_cast<std::size_t>(to);
    const SceneTruth a = scene.truth(i), b = scene.truth(j);
    const RigidTransform T = scene.T_world_cam(j).inverse() * scene.T_world_cam(i);
    int compared = 0, agree = 0, hidden = 0;
    for (int y = 0; y < a.depth.rows; y += 2) {
      for (int x = 0; x < a.depth.cols; x += 2) {
        if (a.mask.at<std::uint8_t>(y, x) != kStaticLabel) continue;
        const double z = static_cast<double>(a.depth.at<float>(y, x));
        const Eigen::Vector3d X = T * scene.camera().unproject({x, y}, z);
        const Eigen::Vector2d p = scene.camera().project(X);
        const double there = plane_depth(b, p);
        if (there == 0.0) continue;
        ++compared;
        if (std::abs(there - X.z()) < 1e-4) {
          ++agree;
        } else {
          hidden += there < X.z() - 1e-4 ? 1 : 0;
        }
      }
    }
    EXPECT_GT(compared, 5000) << from;
    EXPECT_EQ(agree + hidden, compared) << from;  // what disagrees has something in front of it
    EXPECT_GT(agree, compared * 9 / 10) << from;
  }
}

TEST(RenderedScene, FastPathAgreesWithTheOracleAtEveryPixel) {
  constexpr int kStep = dynslam::testing::kSanitized ? 3 : 1;
  SceneOptions odd = small(7, 101, 75);  // no whole number of tiles, principal point off the middle
  odd.camera.cx += 13.3;
  odd.camera.cy -= 8.1;
  odd.camera.fy *= 1.1;
  for (const SceneOptions& options : {small(1), small(2), odd}) {
    const RenderedScene scene(options);
    for (const std::size_t index : {0U, 77U, 313U, 5000U}) {
      const SceneTruth truth = scene.truth(index);
      int other_surface = 0, looked_at = 0;
      for (int y = 0; y < truth.depth.rows; y += kStep) {
        for (int x = 0; x < truth.depth.cols; x += kStep) {
          ++looked_at;
          const auto point = scene.cast(index, {x, y});
          ASSERT_TRUE(point.has_value());
          const double z = static_cast<double>(truth.depth.at<float>(y, x));
          ASSERT_GT(z, 0.0);
          if (point->surface != truth.surface.at<std::uint16_t>(y, x)) {
            ++other_surface;  // an edge to the last bit of a float
            continue;
          }
          ASSERT_EQ(point->label, truth.mask.at<std::uint8_t>(y, x));
          // Along a silhouette depth falls away with an unbounded slope.
          const bool plane = point->label != kPersonLabel;
          ASSERT_NEAR(point->depth, z, plane ? 2e-4 : 2e-3) << x << " " << y << " " << index;
        }
      }
      EXPECT_LE(other_surface * 1000, looked_at + 999) << index;
    }
  }
}

TEST(RenderedScene, OracleLooksOutsideTheImageToo) {
  const RenderedScene scene(small());
  for (const Eigen::Vector2d& pixel :
       {Eigen::Vector2d(-500, 20), Eigen::Vector2d(900, -400), Eigen::Vector2d(80, 4000)}) {
    const auto point = scene.cast(3, pixel);
    ASSERT_TRUE(point.has_value());
    EXPECT_GT(point->depth, 0.0);
    // In the room, up to the walls.
    EXPECT_LE(std::abs(point->in_world.x()), 3.0 + 1e-9);
    EXPECT_LE(std::abs(point->in_world.y()), 2.5 + 1e-9);
    EXPECT_GE(point->in_world.z(), -1e-9);
  }
}

TEST(RenderedScene, NothingIsSeenAtAPixelThatIsNotANumber) {
  const RenderedScene scene(small());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(scene.cast(0, {nan, 1.0}).has_value());
  EXPECT_FALSE(scene.correspondence(0, {1.0, nan}, 1).has_value());
}

TEST(RenderedScene, StillRoomIsTheWalkingRoomWithoutMovers) {
  SceneOptions options = small(4);
  const RenderedScene walking(options);
  options.movers = false;
  const RenderedScene still(options);
  int covered = 0;
  for (std::size_t i = 0; i < 200; i += 25) {
    EXPECT_EQ(walking.T_world_cam(i).R, still.T_world_cam(i).R);
    EXPECT_EQ(walking.T_world_cam(i).t, still.T_world_cam(i).t);
    const SceneTruth a = walking.truth(i), b = still.truth(i);
    EXPECT_EQ(cv::countNonZero(b.mask), 0);
    for (int y = 0; y < a.depth.rows; ++y) {
      for (int x = 0; x < a.depth.cols; ++x) {
        // The mask is where the movers are and nowhere else: there they stand before the room.
        if (a.mask.at<std::uint8_t>(y, x) == kStaticLabel) {
          ASSERT_EQ(a.depth.at<float>(y, x), b.depth.at<float>(y, x));
          ASSERT_EQ(a.surface.at<std::uint16_t>(y, x), b.surface.at<std::uint16_t>(y, x));
        } else {
          ASSERT_LT(a.depth.at<float>(y, x), b.depth.at<float>(y, x));
          ++covered;
        }
      }
    }
  }
  EXPECT_GT(covered, 0);
}

TEST(RenderedScene, FlowIsTheCorrespondenceOfEveryPixel) {
  const RenderedScene scene(small(2));
  const cv::Mat flow = scene.forward_flow(100, 106);
  int visible = 0, hidden = 0;
  for (int y = 2; y < flow.rows; y += 7) {
    for (int x = 2; x < flow.cols; x += 7) {
      const auto c = scene.correspondence(100, {x, y}, 106);
      ASSERT_TRUE(c.has_value());
      const auto& v = flow.at<cv::Vec2f>(y, x);
      EXPECT_NEAR(c->pixel.x() - x, static_cast<double>(v[0]), 2e-2);
      EXPECT_NEAR(c->pixel.y() - y, static_cast<double>(v[1]), 2e-2);
      EXPECT_EQ(c->label, scene.cast(100, {x, y})->label);
      if (c->visible) {
        ++visible;
        EXPECT_NEAR(scene.cast(106, c->pixel)->depth, c->depth, 2e-3);
      } else {
        ++hidden;
      }
    }
  }
  EXPECT_GT(visible, 200);
  EXPECT_GT(hidden, 0);
}

TEST(RenderedScene, FlowOfAFrameToItselfIsZero) {
  const RenderedScene scene(small(2));
  const cv::Mat flow = scene.forward_flow(42, 42);
  for (int y = 0; y < flow.rows; ++y) {
    for (int x = 0; x < flow.cols; ++x) {
      ASSERT_LT(std::abs(flow.at<cv::Vec2f>(y, x)[0]) + std::abs(flow.at<cv::Vec2f>(y, x)[1]),
                1e-3F);
    }
  }
}

TEST(RenderedScene, MoversMoveAgainstTheRoom) {
  const RenderedScene scene(small(5));
  int movers = 0, moved = 0;
  for (const std::size_t i : {10U, 100U, 210U}) {
    const SceneTruth truth = scene.truth(i);
    const RigidTransform T = scene.T_world_cam(i + 3).inverse() * scene.T_world_cam(i);
    for (int y = 0; y < truth.depth.rows; y += 5) {
      for (int x = 0; x < truth.depth.cols; x += 5) {
        const auto c = scene.correspondence(i, {x, y}, i + 3);
        ASSERT_TRUE(c.has_value());
        const double z = static_cast<double>(truth.depth.at<float>(y, x));
        const Eigen::Vector2d if_static =
            scene.camera().project(T * scene.camera().unproject({x, y}, z));
        const double off = (if_static - c->pixel).norm();
        if (truth.mask.at<std::uint8_t>(y, x) == kStaticLabel) {
          ASSERT_LT(off, 1e-2);
        } else {
          ++movers;
          moved += off > 1.0 ? 1 : 0;
        }
      }
    }
  }
  EXPECT_GT(movers, 200);
  EXPECT_GT(moved, movers * 3 / 4);
}

TEST(RenderedScene, SurfacesOfTheRoomDoNotMove) {
  const RenderedScene scene(small());
  const RigidTransform T = scene.T_world_surface(0, 1234);
  EXPECT_EQ(T.R, Eigen::Matrix3d::Identity());
  EXPECT_EQ(T.t, Eigen::Vector3d::Zero());
}

TEST(RenderedScene, VariantIsTheSceneThatItsOptionsMake) {
  SceneOptions options = small(6);
  const RenderedScene scene(options);
  options.movers = false;
  options.motion = CameraMotion::kSideways;
  options.camera = scene_camera(64, 48);
  const RenderedScene variant = scene.variant(options);
  EXPECT_FALSE(variant.options().movers);
  EXPECT_TRUE(same_frame(variant.render(40), RenderedScene(options).render(40)));
}

TEST(RenderedScene, RefusesAVariantWithAnotherSeed) {
  const RenderedScene scene(small(6));
  EXPECT_THROW(scene.variant(small(7)), InvalidArgument);
  SceneOptions bad = small(6);
  bad.fps = -1.0;
  EXPECT_THROW(scene.variant(bad), InvalidArgument);
}

TEST(RenderedScene, RefusesASurfaceThatItDoesNotHave) {
  const RenderedScene scene(small());
  EXPECT_THROW(scene.T_world_surface(-1, 0), InvalidArgument);
  EXPECT_THROW(scene.T_world_surface(scene.surfaces(), 0), InvalidArgument);
  EXPECT_NO_THROW(scene.T_world_surface(scene.surfaces() - 1, 0));
}

}  // namespace
}  // namespace dynslam::dataset
