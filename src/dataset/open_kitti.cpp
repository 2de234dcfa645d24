#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>

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
using Matrix34d = Eigen::Matrix<double, 3, 4>;

constexpr double kKittiFps = 10.0;

bool is_folder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

// The number that a file's stem is, such as 17 for "000017", or nothing.
std::optional<std::size_t> stem_number(const std::string& stem) {
  std::size_t number = 0;
  const char* end = stem.data() + stem.size();
  const auto [stop, error] = std::from_chars(stem.data(), end, number);
  if (stem.empty() || error != std::errc() || stop != end) return std::nullopt;
  return number;
}

// The rows of times.txt or poses.txt belong to the images one to one if there are as many, else by
// the number that is an image's name (a sequence that was cut).
std::size_t row_of(const FrameFiles& frame, std::size_t index, std::size_t rows, std::size_t frames,
                   const fs::path& file) {
  if (rows == frames) return index;
  const std::optional<std::size_t> number = stem_number(frame.name);
  if (number) return *number;
  throw_io_error(file.string(), "there are " + std::to_string(rows) + " rows for " +
                                    std::to_string(frames) + " images, expected as many, or " +
                                    "images whose names are the numbers of their rows");
}

class KittiFolder {
 public:
  KittiFolder(const fs::path& folder, const KittiOptions& options)
      : folder_(folder), options_(options) {
    detail::expect_folder(folder);
    data_.name = detail::folder_name(folder);
  }

  FileSequenceData read() {
    choose_cameras();
    read_images();
    read_camera();
    read_poses();  // before frames are left out for their times
    read_times();
    for (const FrameFiles& frame : data_.frames) {
      if (frame.T_world_cam) data_.truth.push_back({frame.timestamp, *frame.T_world_cam});
    }
    detail::add_masks(folder_, &data_);
    return std::move(data_);
  }

 private:
  void choose_cameras() {
    const bool grey = is_folder(folder_ / "image_0"), color = is_folder(folder_ / "image_2");
    if (!grey && !color) {
      throw_io_error(folder_.string(),
                     "there is neither image_0 nor image_2, expected a KITTI odometry folder");
    }
    left_ = color && (options_.prefer_color || !grey) ? 2 : 0;
    const bool has_right = is_folder(image_folder(left_ + 1));
    data_.sensor = has_right && !options_.left_only ? SensorKind::kStereo : SensorKind::kMono;
  }

  fs::path image_folder(std::size_t camera) const {
    return folder_ / ("image_" + std::to_string(camera));
  }

  void read_images() {
    for (const fs::path& image : detail::list_images(image_folder(left_))) {
      FrameFiles frame;
      frame.name = image.stem().string();
      frame.color = image;
      if (data_.sensor == SensorKind::kStereo) {
        frame.right = image_folder(left_ + 1) / image.filename();
        if (!is_file(frame.right)) {
          throw_io_error(frame.right.string(),
                         "there is no such right image, expected one for " + image.string());
        }
      }
      data_.frames.push_back(std::move(frame));
    }
    if (data_.frames.empty()) {
      throw_io_error(image_folder(left_).string(), "there are no images");
    }
  }

  void read_times() {
    const fs::path file = folder_ / "times.txt";
    std::vector<FrameFiles>& frames = data_.frames;
    data_.fps = is_file(file) ? 0.0 : kKittiFps;
    if (!is_file(file)) {
      for (std::size_t i = 0; i < frames.size(); ++i) {
        frames[i].timestamp = static_cast<double>(i) / kKittiFps;
      }
      return;
    }
    const auto times = parse_kitti_times(detail::read_file(file), file.string());
    OpenReport& report = data_.report;
    detail::OrderCheck order(file.string(), options_.skip_disordered, &report.disordered_frames,
                             &report);
    std::vector<FrameFiles> kept;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const std::size_t row = row_of(frames[i], i, times.size(), frames.size(), file);
      if (row >= times.size()) {
        throw_io_error(file.string(), "there are " + std::to_string(times.size()) +
                                          " times, expected one for " + frames[i].color.string());
      }
      if (!order.accept(times[row].first, times[row].second)) continue;
      frames[i].timestamp = times[row].first;
      kept.push_back(std::move(frames[i]));
    }
    frames = std::move(kept);
  }

  const Matrix34d& projection(const KittiCalibration& calibration, std::size_t k,
                              const fs::path& file) const {
    if (!calibration.P[k]) {
      throw_io_error(file.string(), "there is no matrix P" + std::to_string(k) +
                                        ", expected one for image_" + std::to_string(k));
    }
    return *calibration.P[k];
  }

  void read_camera() {
    const fs::path file = folder_ / "calib.txt";
    if (options_.camera && !is_file(file)) {
      data_.camera = *options_.camera;
      return;
    }
    const KittiCalibration calibration =
        parse_kitti_calibration(detail::read_file(file), file.string());
    const Matrix34d& P = projection(calibration, left_, file);
    // P = K [I | c]: the camera sits at -c in the frame of camera 0, to which the poses belong.
    const Eigen::Matrix3d K = P.leftCols<3>();
    T_cam0_cam_ = RigidTransform(Eigen::Matrix3d::Identity(), -(K.inverse() * P.col(3)));
    data_.camera.fx = P(0, 0);
    data_.camera.fy = P(1, 1);
    data_.camera.cx = P(0, 2);
    data_.camera.cy = P(1, 2);
    if (data_.sensor == SensorKind::kStereo) read_baseline(calibration, P, file);
    if (!options_.camera) return;
    const double baseline = data_.camera.baseline();
    data_.camera = *options_.camera;
    if (data_.sensor == SensorKind::kStereo) data_.camera.bf = baseline * data_.camera.fx;
  }

  void read_baseline(const KittiCalibration& calibration, const Matrix34d& P,
                     const fs::path& file) {
    constexpr double kSlack = 1e-6;
    const Matrix34d& right = projection(calibration, left_ + 1, file);
    const std::string pair = "P" + std::to_string(left_) + " and P" + std::to_string(left_ + 1);
    if (!((right - P).leftCols<3>().norm() <= kSlack * P.norm())) {
      throw_io_error(file.string(), pair + " have other intrinsics, expected a rectified pair");
    }
    data_.camera.bf = P(0, 3) - right(0, 3);
    if (!(data_.camera.bf > 0.0)) {
      throw_io_error(file.string(),
                     pair + " put the right camera to the left, expected a positive baseline");
    }
  }

  fs::path pose_file() const {
    std::error_code error;
    fs::path own = folder_ / "poses.txt";
    if (is_file(own)) return own;
    const fs::path whole = fs::canonical(folder_, error);
    const fs::path official =
        whole.parent_path().parent_path() / "poses" / (whole.filename().string() + ".txt");
    const bool in_sequences = whole.parent_path().filename() == "sequences";
    return in_sequences && is_file(official) ? official : fs::path();
  }

  void read_poses() {
    const fs::path file = pose_file();
    if (file.empty()) return;
    const std::vector<RigidTransform> poses =
        parse_kitti_poses(detail::read_file(file), file.string());
    if (poses.empty()) throw_io_error(file.string(), "there are no poses");
    for (std::size_t i = 0; i < data_.frames.size(); ++i) {
      FrameFiles& frame = data_.frames[i];
      const std::size_t row = row_of(frame, i, poses.size(), data_.frames.size(), file);
      if (row < poses.size()) frame.T_world_cam = poses[row] * T_cam0_cam_;
    }
  }

  fs::path folder_;
  const KittiOptions& options_;
  FileSequenceData data_;
  std::size_t left_ = 0;       // number of the left camera
  RigidTransform T_cam0_cam_;  // the left camera in the frame of the poses
};

}  // namespace

void KittiOptions::validate() const { detail::validate_camera(camera, "KittiOptions"); }

std::unique_ptr<Sequence> open_kitti(const fs::path& folder, const KittiOptions& options) {
  options.validate();
  return detail::make_file_sequence(KittiFolder(folder, options).read(), folder);
}

}  // namespace dynslam::dataset
