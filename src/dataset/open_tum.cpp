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
using detail::OrderCheck;

class TumFolder {
 public:
  TumFolder(const fs::path& folder, const TumOptions& options)
      : folder_(folder), options_(options) {
    detail::expect_folder(folder);
    data_.name = detail::folder_name(folder);
  }

  FileSequenceData read() {
    read_frames();
    read_camera();
    read_truth();
    detail::add_masks(folder_, &data_);
    return std::move(data_);
  }

 private:
  bool has(const char* file) const {
    std::error_code error;
    return fs::exists(folder_ / file, error);
  }
  std::string path(const char* file) const { return (folder_ / file).string(); }
  std::string content(const char* file) const { return detail::read_file(folder_ / file); }

  void read_frames() {
    if (has("associations.txt")) {
      read_associations();
    } else if (!has("rgb.txt")) {
      throw_io_error(folder_.string(),
                     "there is neither associations.txt nor rgb.txt, expected a TUM RGB-D folder");
    } else if (has("depth.txt")) {
      associate_lists();
    } else {
      data_.sensor = SensorKind::kMono;
      for (const ImageRow& row : ordered_rows("rgb.txt")) add_frame(row, nullptr);
    }
  }

  void read_associations() {
    const char* file = "associations.txt";
    data_.sensor = SensorKind::kRgbd;
    OpenReport& report = data_.report;
    OrderCheck order(path(file), options_.skip_disordered, &report.disordered_frames, &report);
    for (const AssociationRow& row : parse_tum_associations(content(file), path(file))) {
      if (order.accept(row.color.timestamp, row.color.line)) add_frame(row.color, &row.depth);
    }
    if (data_.frames.empty()) throw_io_error(path(file), "there are no frames");
  }

  std::vector<ImageRow> ordered_rows(const char* file) {
    OpenReport& report = data_.report;
    OrderCheck order(path(file), options_.skip_disordered, &report.disordered_frames, &report);
    std::vector<ImageRow> rows;
    for (ImageRow& row : parse_tum_images(content(file), path(file))) {
      if (order.accept(row.timestamp, row.line)) rows.push_back(std::move(row));
    }
    if (rows.empty()) throw_io_error(path(file), "there are no images");
    return rows;
  }

  void associate_lists() {
    data_.sensor = SensorKind::kRgbd;
    const std::vector<ImageRow> color = ordered_rows("rgb.txt");
    const std::vector<ImageRow> depth = ordered_rows("depth.txt");
    const auto times = [](const std::vector<ImageRow>& rows) {
      std::vector<double> result;
      result.reserve(rows.size());
      for (const ImageRow& row : rows) result.push_back(row.timestamp);
      return result;
    };
    const std::vector<double> color_times = times(color), depth_times = times(depth);
    for (const auto& [c, d] : associate(color_times, depth_times, options_.max_time_difference)) {
      add_frame(color[c], &depth[d]);
    }
    data_.report.unmatched_frames = color.size() - data_.frames.size();
    if (data_.frames.empty()) {
      throw_io_error(path("rgb.txt"), "no image has a depth image in depth.txt within " +
                                          std::to_string(options_.max_time_difference) + " s");
    }
  }

  void add_frame(const ImageRow& color, const ImageRow* depth) {
    FrameFiles frame;
    frame.timestamp = color.timestamp;
    frame.color = folder_ / color.file;
    frame.name = frame.color.stem().string();
    if (depth != nullptr) frame.depth = folder_ / depth->file;
    data_.frames.push_back(std::move(frame));
  }

  void read_camera() {
    std::optional<CameraFile> file;
    if (has("camera.txt")) {
      file = parse_camera(content("camera.txt"), path("camera.txt"));
    } else {
      file = known_tum_camera(data_.name);
    }
    if (!file && !options_.camera) {
      throw_io_error(
          folder_.string(),
          "the camera is not known, expected camera.txt (\"fx .. fy .. cx .. cy ..\"), a "
          "folder name with freiburg1, freiburg2, freiburg3 or rgbd_bonn_, or a camera "
          "in the options");
    }
    if (file) {
      data_.camera = file->camera;
      data_.fps = file->fps.value_or(0.0);
      data_.depth_scale = file->depth_scale.value_or(data_.depth_scale);
    }
    if (options_.camera) data_.camera = *options_.camera;
    if (options_.depth_scale) data_.depth_scale = *options_.depth_scale;
    if (!options_.camera && options_.undistort) undistort(file->distortion);
  }

  void undistort(const Distortion& distortion) {
    if (distortion == Distortion{}) return;
    DepthCamera& camera = data_.camera;
    if (camera.width == 0 || camera.height == 0) {
      throw_io_error(path("camera.txt"),
                     "a camera with distortion has no size, expected width and height");
    }
    const cv::Mat K =
        (cv::Mat_<double>(3, 3) << camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
    data_.undistorter = {camera, distortion, cv::Mat(), K, folder_.string()};
  }

  void read_truth() {
    const char* file = "groundtruth.txt";
    if (!has(file)) return;
    data_.truth = detail::ordered_truth(parse_tum_poses(content(file), path(file)), path(file),
                                        options_.skip_disordered, &data_.report);
    if (data_.truth.empty()) throw_io_error(path(file), "there are no poses");
    detail::add_poses(options_.max_truth_gap, &data_);
  }

  fs::path folder_;
  const TumOptions& options_;
  FileSequenceData data_;
};

}  // namespace

void TumOptions::validate() const {
  detail::validate_camera(camera, "TumOptions");
  if (depth_scale) {
    require(std::isfinite(*depth_scale) && *depth_scale > 0.0, "TumOptions", "depth_scale",
            *depth_scale, "a positive number");
  }
  detail::require_seconds(max_time_difference, "TumOptions", "max_time_difference");
  detail::require_seconds(max_truth_gap, "TumOptions", "max_truth_gap");
}

std::unique_ptr<Sequence> open_tum(const fs::path& folder, const TumOptions& options) {
  options.validate();
  return detail::make_file_sequence(TumFolder(folder, options).read(), folder);
}

}  // namespace dynslam::dataset
