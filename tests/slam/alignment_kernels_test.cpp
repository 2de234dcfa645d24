#include "slam/alignment_kernels.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/core/so3.hpp"

#include "slam/depth_alignment.hpp"

namespace dynslam::slam {
namespace {

using kernels::AlignmentSums;

template <typename Check>
void on_every_target(const Check& check) {
  for (const auto target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    SCOPED_TRACE(hwy::TargetName(target));
    check();
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

// A width that no vector divides.
PinholeCamera narrow_camera() {
  PinholeCamera camera;
  camera.fx = camera.fy = 130.0;
  camera.cx = 81.0;
  camera.cy = 58.0;
  camera.width = 163;
  camera.height = 118;
  return camera;
}

// A wavy wall with a step, holes and a pattern.
SurfaceGrid wavy_wall(std::uint32_t seed) {
  const PinholeCamera camera = narrow_camera();
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> percent(0, 99);
  std::uniform_real_distribution<float> share(0.0F, 1.0F);
  cv::Mat depth(camera.height, camera.width, CV_32FC1);
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      const float wave = 0.05F * std::sin(0.07F * static_cast<float>(x)) +
                         0.04F * std::cos(0.09F * static_cast<float>(y));
      const float wall = x > 100 ? 1.5F : 2.0F;
      depth.at<float>(y, x) = percent(random) < 2 ? 0.0F : wall + wave + 0.002F * share(random);
    }
  }
  cv::Mat gray(camera.height / kSurfaceCell, camera.width / kSurfaceCell, CV_8UC1);
  for (int y = 0; y < gray.rows; ++y) {
    for (int x = 0; x < gray.cols; ++x) {
      gray.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(100 + 40 * std::sin(0.9 * x + y));
    }
  }
  SurfaceGrid cells;
  build_surface_grid(depth, gray, camera, cells);
  cells.trust.create(cells.height, cells.width, CV_32FC1);
  for (float& trust : cv::Mat_<float>(cells.trust)) {
    trust = percent(random) < 10 ? 0.0F : share(random);
  }
  return cells;
}

// What the kernel computes, a cell at a time and in double precision.
class PlainSums {
 public:
  PlainSums(const SurfaceGrid& from, const SurfaceGrid& to, const RigidTransform& T,
            const kernels::Matching& matching)
      : from_(from), to_(to), T_(T), matching_(matching) {
    for (int y = 0; y < to_.height; y += matching.step) {
      for (int x = 0; x < to_.width; x += matching.step) add_cell(y * to_.width + x);
    }
  }

  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  double squares = 0.0, chi2 = 0.0, trust = 0.0;
  int partners = 0, candidates = 0;

 private:
  void add_cell(int i) {
    const Eigen::Vector3d normal = to_.normals[static_cast<std::size_t>(i)].cast<double>();
    if (normal.squaredNorm() < 0.5) return;
    const double z = to_.points[static_cast<std::size_t>(i)].z();
    const Eigen::Vector3d p = T_ * to_.points[static_cast<std::size_t>(i)].cast<double>().eval();
    if (p.z() <= kMinDepth) return;
    const Eigen::Vector2d pixel = camera_.project(p);
    if (!camera_.contains(pixel)) return;
    ++candidates;
    const int x = std::min(static_cast<int>(pixel.x()) / kSurfaceCell, from_.width - 1);
    const int y = std::min(static_cast<int>(pixel.y()) / kSurfaceCell, from_.height - 1);
    const auto j = static_cast<std::size_t>(y * from_.width + x);
    const Eigen::Vector3d n = from_.normals[j].cast<double>();
    const Eigen::Vector3d gap = p - from_.points[j].cast<double>();
    const double counts = from_.trust.empty() ? 1.0 : from_.trust.at<float>(y, x);
    if (n.squaredNorm() < 0.5 || gap.norm() > matching_.gate || counts <= 0.0) return;
    if (n.dot(T_.R * normal) < matching_.min_cosine) return;
    ++partners;
    squares += n.dot(gap) * n.dot(gap);
    const double off = z - 0.4;
    const double sigma = 0.0012 + 0.0019 * off * off;
    add_residual(p, n, n.dot(gap), std::max<double>(kernels::kLeastNoise, sigma), counts);
    if (matching_.gray_sigma > 0.0F) add_brightness(static_cast<std::size_t>(i), p, pixel, counts);
  }

  void add_brightness(std::size_t i, const Eigen::Vector3d& p, const Eigen::Vector2d& pixel,
                      double counts) {
    const double u = (pixel.x() + 0.5) / kSurfaceCell - 0.5;
    const double v = (pixel.y() + 0.5) / kSurfaceCell - 0.5;
    const int x = static_cast<int>(std::floor(u)), y = static_cast<int>(std::floor(v));
    if (x < 0 || y < 0 || x + 1 >= from_.width || y + 1 >= from_.height) return;
    const auto at = [&](int row, int column) -> double {
      return from_.gray.at<float>(row, column);
    };
    const double a = u - x, b = v - y;
    const double upper = (1 - a) * at(y, x) + a * at(y, x + 1);
    const double lower = (1 - a) * at(y + 1, x) + a * at(y + 1, x + 1);
    const double right =
        (1 - b) * (at(y, x + 1) - at(y, x)) + b * (at(y + 1, x + 1) - at(y + 1, x));
    const Eigen::RowVector2d slope(right / kSurfaceCell, (lower - upper) / kSurfaceCell);
    const Eigen::Vector3d d = (slope * camera_.project_jacobian(p)).transpose();
    const double value = (1 - b) * upper + b * lower;
    add_residual(p, d, value - to_.gray.ptr<float>()[i], matching_.gray_sigma, counts);
  }

  void add_residual(const Eigen::Vector3d& p, const Eigen::Vector3d& d, double r, double sigma,
                    double counts) {
    Vector6d J;
    J << d, p.cross(d);
    const double whitened = std::abs(r) / sigma;
    const double huber = whitened > kernels::kHuber ? kernels::kHuber / whitened : 1.0;
    H += counts * huber / (sigma * sigma) * J * J.transpose();
    g += counts * huber / (sigma * sigma) * r * J;
    chi2 += counts * std::min<double>(whitened * whitened, matching_.max_chi2);
    trust += counts;
  }

  const SurfaceGrid& from_;
  const SurfaceGrid& to_;
  RigidTransform T_;
  kernels::Matching matching_;
  PinholeCamera camera_ = narrow_camera();
};

AlignmentSums vector_sums(const SurfaceGrid& from, const SurfaceGrid& to, const RigidTransform& T,
                          const kernels::Matching& matching) {
  return kernels::sum_partners(from, to, narrow_camera(), T, matching);
}

// A cell whose point lies on an edge of what counts may fall to either side.
constexpr int kOnEdges = 1;

void expect_same(const AlignmentSums& sums, const PlainSums& plain) {
  EXPECT_NEAR(sums.candidates, plain.candidates, kOnEdges);
  EXPECT_NEAR(sums.partners, plain.partners, kOnEdges);
  const double share = 0.002 + static_cast<double>(kOnEdges) / plain.partners;
  EXPECT_NEAR(sums.trust, plain.trust, share * plain.trust);
  EXPECT_NEAR(sums.chi2, plain.chi2, share * plain.chi2 + 25.0 * kOnEdges);
  EXPECT_NEAR(sums.squares, plain.squares, share * plain.squares);
  int k = 0;
  for (int i = 0; i < 6; ++i) {
    const double size = std::sqrt(plain.H(i, i) * plain.chi2);
    EXPECT_NEAR(sums.g[i], plain.g[i], share * size) << i;
    for (int j = i; j < 6; ++j, ++k) {
      const double scale = std::sqrt(plain.H(i, i) * plain.H(j, j));
      EXPECT_NEAR(sums.H[k], plain.H(i, j), share * scale) << i << ' ' << j;
    }
  }
}

TEST(AlignmentKernels, AddUpAsAPlainLoopDoes) {
  const SurfaceGrid from = wavy_wall(1), to = wavy_wall(2);
  const RigidTransform T(so3_exp({0.01, -0.02, 0.005}), {0.01, -0.015, 0.02});
  on_every_target([&] {
    for (const int step : {1, 2, 3}) {
      for (const float gray_sigma : {0.0F, 6.0F}) {
        SCOPED_TRACE(testing::Message() << "step " << step << " gray " << gray_sigma);
        const kernels::Matching matching{0.12F, gray_sigma, 0.7F, 25.0F, step};
        const PlainSums plain(from, to, T, matching);
        ASSERT_GT(plain.partners, 50);
        expect_same(vector_sums(from, to, T, matching), plain);
      }
    }
  });
}

TEST(AlignmentKernels, TrustEveryCellWithoutWeights) {
  SurfaceGrid from = wavy_wall(3);
  from.trust.release();
  const SurfaceGrid to = wavy_wall(4);
  const kernels::Matching matching{0.12F, 0.0F, 0.7F, 25.0F, 1};
  const PlainSums plain(from, to, RigidTransform(), matching);
  on_every_target([&] { expect_same(vector_sums(from, to, RigidTransform(), matching), plain); });
  EXPECT_EQ(plain.trust, plain.partners);
}

TEST(AlignmentKernels, MeetNothingBehindTheCameraOrBesideTheImage) {
  const SurfaceGrid from = wavy_wall(5), to = wavy_wall(6);
  const kernels::Matching matching{0.3F, 6.0F, 0.7F, 25.0F, 1};
  const RigidTransform behind(Eigen::Matrix3d::Identity(), {0.0, 0.0, -10.0});
  const RigidTransform beside(Eigen::Matrix3d::Identity(), {100.0, 0.0, 0.0});
  on_every_target([&] {
    for (const RigidTransform& T : {behind, beside}) {
      const AlignmentSums sums = vector_sums(from, to, T, matching);
      EXPECT_EQ(sums.candidates, 0);
      EXPECT_EQ(sums.partners, 0);
      EXPECT_EQ(*std::max_element(sums.H, sums.H + 21), 0.0);
    }
  });
}

}  // namespace
}  // namespace dynslam::slam
