#include <cmath>
#include <string>

#include <Eigen/SVD>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

#include "dataset/text.hpp"

namespace dynslam::dataset {
namespace {

using detail::LineReader;
using Matrix34d = Eigen::Matrix<double, 3, 4>;

Matrix34d matrix_from(const LineReader& reader, std::size_t first_field) {
  Matrix34d m;
  for (Eigen::Index i = 0; i < 12; ++i) {
    m(i / 4, i % 4) = reader.number(first_field + static_cast<std::size_t>(i), "the matrix");
  }
  return m;
}

void check_projection(const LineReader& reader, const Matrix34d& P) {
  const bool pinhole = P(0, 0) > 0.0 && P(1, 1) > 0.0 && P(0, 1) == 0.0 && P(1, 0) == 0.0 &&
                       P(2, 0) == 0.0 && P(2, 1) == 0.0 && P(2, 2) == 1.0;
  if (!pinhole) {
    reader.fail("the matrix is no projection, expected fx 0 cx a  0 fy cy b  0 0 1 c");
  }
}

// Index of "P0:" .. "P3:", or nothing for another label.
std::optional<std::size_t> projection_index(std::string_view label) {
  if (label.size() == 3 && label[0] == 'P' && label[1] >= '0' && label[1] <= '3') {
    return static_cast<std::size_t>(label[1] - '0');
  }
  return std::nullopt;
}

}  // namespace

KittiCalibration parse_kitti_calibration(std::string_view text, std::string_view path) {
  constexpr std::string_view kForm = "12 numbers, or \"P0:\" and 12 numbers";
  LineReader reader(text, path);
  KittiCalibration calibration;
  std::size_t bare = 0;
  while (reader.next()) {
    const bool labelled = reader.fields()[0].back() == ':';
    std::optional<std::size_t> k;
    if (labelled) {
      k = projection_index(reader.fields()[0]);
    } else if (bare++ < calibration.P.size()) {
      k = bare - 1;
    }
    if (!k) continue;  // Tr, the laser's pose
    reader.expect_fields(labelled ? 13 : 12, kForm);
    if (calibration.P[*k]) reader.fail("P" + std::to_string(*k) + " is given twice, expected once");
    const Matrix34d P = matrix_from(reader, labelled ? 1 : 0);
    check_projection(reader, P);
    calibration.P[*k] = P;
  }
  if (!calibration.P[0])
    throw_io_error(path, "there is no matrix P0, expected " + std::string(kForm));
  return calibration;
}

std::vector<std::pair<double, std::size_t>> parse_kitti_times(std::string_view text,
                                                              std::string_view path) {
  LineReader reader(text, path);
  std::vector<std::pair<double, std::size_t>> times;
  while (reader.next()) {
    reader.expect_fields(1, "1: the time");
    times.emplace_back(reader.number(0, "the time"), reader.line());
  }
  return times;
}

std::vector<RigidTransform> parse_kitti_poses(std::string_view text, std::string_view path) {
  constexpr double kLargestDefect = 1e-2;  // files have seven digits; this is a wrong format
  LineReader reader(text, path);
  std::vector<RigidTransform> poses;
  while (reader.next()) {
    reader.expect_fields(12, "12: a 3 x 4 matrix by rows");
    const Matrix34d m = matrix_from(reader, 0);
    const Eigen::JacobiSVD<Eigen::Matrix3d, Eigen::NoQRPreconditioner> svd(
        m.leftCols<3>(), Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
    if (!((R - m.leftCols<3>()).norm() <= kLargestDefect) || !(R.determinant() > 0.0)) {
      reader.fail("the left 3 x 3 block is no rotation, expected one");
    }
    poses.emplace_back(R, m.col(3));
  }
  return poses;
}

}  // namespace dynslam::dataset
