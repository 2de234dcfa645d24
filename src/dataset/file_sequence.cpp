#include "dataset/file_sequence.hpp"

#include <algorithm>
#include <cmath>
#include <system_error>
#include <utility>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

#include "dataset/image_file.hpp"
#include "dataset/text.hpp"

namespace dynslam::dataset::detail {
namespace {

constexpr double kDefaultFps = 30.0;  // of a single frame without a rate

std::string size_text(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

class FileSequence final : public Sequence {
 public:
  explicit FileSequence(FileSequenceData data) : data_(std::move(data)) {}

  std::string name() const override { return data_.name; }
  std::size_t size() const override { return data_.frames.size(); }
  double timestamp(std::size_t index) const override { return files("timestamp", index).timestamp; }
  std::string frame_name(std::size_t index) const override {
    return files("frame_name", index).name;
  }
  DepthCamera camera() const override { return data_.camera; }
  SensorKind sensor() const override { return data_.sensor; }
  double fps() const override { return data_.fps; }
  const Trajectory& truth() const override { return data_.truth; }
  OpenReport report() const override { return data_.report; }

  Frame read(std::size_t index) const override {
    const FrameFiles& file = files("read", index);
    Frame frame;
    frame.index = index;
    frame.timestamp = file.timestamp;
    frame.name = file.name;
    frame.T_world_cam = file.T_world_cam;
    frame.color = read_color(file.color);
    expect_size(frame.color, file.color);
    frame.color = data_.undistorter.smooth(frame.color);
    if (!file.depth.empty()) {
      frame.depth = read_depth(file.depth, data_.depth_scale);
      expect_size(frame.depth, file.depth);
      frame.depth = data_.undistorter.nearest(frame.depth);
    }
    if (!file.right.empty()) {
      frame.right = read_color(file.right);
      expect_size(frame.right, file.right);
      if (frame.right.type() != frame.color.type()) {
        throw_io_error(file.right.string(), "only one of the left and right image is in colour");
      }
      frame.right = data_.right_undistorter.smooth(frame.right);
    }
    if (!file.mask.empty()) {
      frame.mask = read_mask(file.mask);
      expect_size(frame.mask, file.mask);
      frame.mask = data_.undistorter.nearest(frame.mask);
    }
    return frame;
  }

 private:
  const FrameFiles& files(const char* function, std::size_t index) const {
    if (index >= data_.frames.size()) {
      throw_invalid_argument(std::string("Sequence::") + function, "index", index,
                             "less than " + std::to_string(data_.frames.size()));
    }
    return data_.frames[index];
  }

  void expect_size(const cv::Mat& image, const std::filesystem::path& path) const {
    if (image.cols == data_.camera.width && image.rows == data_.camera.height) return;
    throw_io_error(path.string(), "the image has " + size_text(image.cols, image.rows) +
                                      " pixels, expected the camera's " +
                                      size_text(data_.camera.width, data_.camera.height));
  }

  FileSequenceData data_;
};

// Of the first image that can be read: one bad file must not close a sequence.
cv::Size first_size(const std::vector<FrameFiles>& frames) {
  for (std::size_t i = 0; i < frames.size(); ++i) {
    try {
      return read_color(frames[i].color).size();
    } catch (const IoError&) {
      if (i + 1 == frames.size()) throw;
    }
  }
  return {};
}

double rate_of(const std::vector<FrameFiles>& frames) {
  std::vector<double> steps;
  for (std::size_t i = 1; i < frames.size(); ++i) {
    steps.push_back(frames[i].timestamp - frames[i - 1].timestamp);
  }
  if (steps.empty()) return kDefaultFps;
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  const double fps = 1.0 / *middle;
  return std::isfinite(fps) && fps > 0.0 ? fps : kDefaultFps;
}

}  // namespace

Undistorter::Undistorter(const PinholeCamera& camera, const Distortion& distortion,
                         const cv::Mat& R, const cv::Mat& K, const std::string& path) {
  const cv::Matx33d K_file(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
  const cv::Mat coefficients(1, 5, CV_64F, const_cast<double*>(distortion.data()));
  const cv::Size size(camera.width, camera.height);
  try {
    cv::initUndistortRectifyMap(K_file, coefficients, R, K, size, CV_16SC2, map_, fraction_);
    cv::Mat x, y, unused;
    cv::initUndistortRectifyMap(K_file, coefficients, R, K, size, CV_32FC1, x, y);
    cv::convertMaps(x, y, nearest_map_, unused, CV_16SC2, true);
  } catch (const cv::Exception& error) {
    throw_io_error(path, "the calibration cannot be used: " + error.msg);
  }
}

cv::Mat Undistorter::smooth(const cv::Mat& image) const {
  if (empty()) return image;
  cv::Mat result;
  cv::remap(image, result, map_, fraction_, cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  return result;
}

cv::Mat Undistorter::nearest(const cv::Mat& image) const {
  if (empty()) return image;
  cv::Mat result;
  cv::remap(image, result, nearest_map_, cv::Mat(), cv::INTER_NEAREST, cv::BORDER_CONSTANT);
  return result;
}

std::unique_ptr<Sequence> make_file_sequence(FileSequenceData data,
                                             const std::filesystem::path& folder) {
  if (data.frames.empty()) throw_io_error(folder.string(), "there are no frames");
  if (data.camera.width == 0 || data.camera.height == 0) {
    const cv::Size size = first_size(data.frames);
    data.camera.width = size.width;
    data.camera.height = size.height;
  }
  try {
    data.camera.validate();
  } catch (const InvalidArgument& error) {
    throw_io_error(folder.string(), error.what());
  }
  if (data.fps == 0.0) data.fps = rate_of(data.frames);
  return std::make_unique<FileSequence>(std::move(data));
}

void add_poses(double max_gap, FileSequenceData* data) {
  for (FrameFiles& frame : data->frames) {
    frame.T_world_cam = pose_at(data->truth, frame.timestamp, max_gap);
  }
}

void add_masks(const std::filesystem::path& folder, FileSequenceData* data) {
  std::error_code error;
  if (!std::filesystem::is_directory(folder / "mask", error)) return;
  for (FrameFiles& frame : data->frames) {
    const std::filesystem::path mask = folder / "mask" / (frame.name + ".png");
    if (std::filesystem::exists(mask, error)) frame.mask = mask;
  }
}

bool OrderCheck::accept(double timestamp, std::size_t line) {
  if (!last_ || timestamp > *last_) {
    last_ = timestamp;
    return true;
  }
  const std::string what =
      timestamp == *last_ ? "the time repeats that of an earlier row, expected increasing times"
                          : "the time goes back, expected increasing times";
  if (!skip_) fail_at_line(path_, line, what);
  ++*count_;
  if (report_->first_disordered.empty()) {
    report_->first_disordered = path_ + ":" + std::to_string(line) + ": " + what;
  }
  return false;
}

Trajectory ordered_truth(const std::vector<PoseRow>& rows, const std::string& path, bool skip,
                         OpenReport* report) {
  OrderCheck order(path, skip, &report->disordered_truth, report);
  Trajectory truth;
  truth.reserve(rows.size());
  for (const PoseRow& row : rows) {
    if (order.accept(row.pose.timestamp, row.line)) truth.push_back(row.pose);
  }
  return truth;
}

}  // namespace dynslam::dataset::detail
