#include <utility>

#include <opencv2/calib3d.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/readers.hpp"

#include "dataset/file_sequence.hpp"
#include "dataset/files.hpp"
#include "dataset/options.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;
using detail::FileSequenceData;
using detail::FrameFiles;
using detail::OrderCheck;

cv::Mat intrinsic_matrix(const PinholeCamera& camera) {
  return (cv::Mat_<double>(3, 3) << camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
}

class EurocFolder {
 public:
  EurocFolder(const fs::path& folder, const EurocOptions& options)
      : folder_(folder), options_(options) {
    detail::expect_folder(folder);
    std::error_code error;
    const bool inside = detail::folder_name(folder) == "mav0";
    data_.name = inside ? detail::folder_name(folder / "..") : detail::folder_name(folder);
    if (fs::is_directory(folder / "mav0", error)) folder_ /= "mav0";
    stereo_ = !options.left_only && fs::is_directory(folder_ / "cam1", error);
  }

  FileSequenceData read() {
    const EurocCamera left = read_camera("cam0");
    data_.fps = left.file.fps.value_or(0.0);
    if (stereo_) {
      rectify(left, read_camera("cam1"));
      read_pairs();
    } else {
      undistort(left);
      for (const ImageRow& row : ordered_rows("cam0")) add_frame(row, nullptr);
    }
    read_truth(left.T_body_cam);
    return std::move(data_);
  }

 private:
  EurocCamera read_camera(const char* name) const {
    const fs::path file = folder_ / name / "sensor.yaml";
    return parse_euroc_camera(detail::read_file(file), file.string());
  }

  void undistort(const EurocCamera& left) {
    data_.camera = left.file.camera;
    if (left.file.distortion == Distortion{}) return;
    data_.undistorter = {left.file.camera, left.file.distortion, cv::Mat(),
                         intrinsic_matrix(left.file.camera), (folder_ / "cam0").string()};
  }

  void rectify(const EurocCamera& left, const EurocCamera& right) {
    const std::string path = (folder_ / "cam1" / "sensor.yaml").string();
    const DepthCamera& l = left.file.camera;
    const DepthCamera& r = right.file.camera;
    if (l.width != r.width || l.height != r.height) {
      throw_io_error(path, "the resolution is not that of cam0, expected the same");
    }
    data_.sensor = SensorKind::kStereo;
    const RigidTransform T_right_left = right.T_body_cam.inverse() * left.T_body_cam;
    cv::Mat R(3, 3, CV_64F), t(3, 1, CV_64F), R_left, R_right, P_left, P_right, Q;
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) R.at<double>(i, j) = T_right_left.R(i, j);
      t.at<double>(i) = T_right_left.t(i);
    }
    constexpr double kLeastBaseline = 1e-4;
    if (!(T_right_left.t.norm() > kLeastBaseline)) {
      throw_io_error(path, "cam1 is where cam0 is, expected a baseline");
    }
    try {
      cv::stereoRectify(intrinsic_matrix(l), cv::Mat(1, 5, CV_64F, coefficients(left)),
                        intrinsic_matrix(r), cv::Mat(1, 5, CV_64F, coefficients(right)),
                        cv::Size(l.width, l.height), R, t, R_left, R_right, P_left, P_right, Q,
                        cv::CALIB_ZERO_DISPARITY, 0.0);
    } catch (const cv::Exception& error) {
      throw_io_error(path, "the pair cannot be rectified: " + error.msg);
    }
    set_rectified_camera(l, P_left, P_right, path);
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) R_rectified_left_(i, j) = R_left.at<double>(i, j);
    }
    const cv::Mat K = P_left.colRange(0, 3);
    data_.undistorter = {l, left.file.distortion, R_left, K, path};
    data_.right_undistorter = {r, right.file.distortion, R_right, K, path};
  }

  static double* coefficients(const EurocCamera& camera) {
    return const_cast<double*>(camera.file.distortion.data());
  }

  void set_rectified_camera(const DepthCamera& size, const cv::Mat& P_left, const cv::Mat& P_right,
                            const std::string& path) {
    DepthCamera& camera = data_.camera;
    camera.width = size.width;
    camera.height = size.height;
    camera.fx = P_left.at<double>(0, 0);
    camera.fy = P_left.at<double>(1, 1);
    camera.cx = P_left.at<double>(0, 2);
    camera.cy = P_left.at<double>(1, 2);
    camera.bf = -P_right.at<double>(0, 3);
    if (!(camera.bf > 0.0)) {
      throw_io_error(path, "cam1 is not to the right of cam0, expected a left and a right camera");
    }
  }

  std::vector<ImageRow> ordered_rows(const char* camera) {
    const fs::path file = folder_ / camera / "data.csv";
    OpenReport& report = data_.report;
    OrderCheck order(file.string(), options_.skip_disordered, &report.disordered_frames, &report);
    std::vector<ImageRow> rows;
    for (ImageRow& row : parse_euroc_images(detail::read_file(file), file.string())) {
      if (order.accept(row.timestamp, row.line)) rows.push_back(std::move(row));
    }
    if (rows.empty()) throw_io_error(file.string(), "there are no images");
    return rows;
  }

  void read_pairs() {
    const std::vector<ImageRow> left = ordered_rows("cam0"), right = ordered_rows("cam1");
    std::vector<double> left_times, right_times;
    for (const ImageRow& row : left) left_times.push_back(row.timestamp);
    for (const ImageRow& row : right) right_times.push_back(row.timestamp);
    for (const auto& [l, r] : associate(left_times, right_times, options_.max_time_difference)) {
      add_frame(left[l], &right[r]);
    }
    data_.report.unmatched_frames = left.size() - data_.frames.size();
    if (data_.frames.empty()) {
      throw_io_error((folder_ / "cam1" / "data.csv").string(),
                     "no image of cam0 has one of cam1 within " +
                         std::to_string(options_.max_time_difference) + " s");
    }
  }

  void add_frame(const ImageRow& left, const ImageRow* right) {
    FrameFiles frame;
    frame.timestamp = left.timestamp;
    frame.color = folder_ / "cam0" / "data" / left.file;
    frame.name = frame.color.stem().string();
    if (right != nullptr) frame.right = folder_ / "cam1" / "data" / right->file;
    data_.frames.push_back(std::move(frame));
  }

  void read_truth(const RigidTransform& T_body_cam) {
    const fs::path file = folder_ / "state_groundtruth_estimate0" / "data.csv";
    std::error_code error;
    if (!fs::exists(file, error)) return;
    data_.truth = detail::ordered_truth(parse_euroc_poses(detail::read_file(file), file.string()),
                                        file.string(), options_.skip_disordered, &data_.report);
    if (data_.truth.empty()) throw_io_error(file.string(), "there are no poses");
    const RigidTransform T_body_rectified =
        T_body_cam * RigidTransform(R_rectified_left_.transpose().eval(), Eigen::Vector3d::Zero());
    for (StampedPose& pose : data_.truth) pose.T_world_cam = pose.T_world_cam * T_body_rectified;
    detail::add_poses(options_.max_truth_gap, &data_);
  }

  fs::path folder_;
  const EurocOptions& options_;
  FileSequenceData data_;
  bool stereo_ = false;
  Eigen::Matrix3d R_rectified_left_ = Eigen::Matrix3d::Identity();
};

}  // namespace

void EurocOptions::validate() const {
  detail::require_seconds(max_time_difference, "EurocOptions", "max_time_difference");
  detail::require_seconds(max_truth_gap, "EurocOptions", "max_truth_gap");
}

std::unique_ptr<Sequence> open_euroc(const fs::path& folder, const EurocOptions& options) {
  options.validate();
  return detail::make_file_sequence(EurocFolder(folder, options).read(), folder);
}

}  // namespace dynslam::dataset
