#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

#include "dataset/text.hpp"

namespace dynslam::dataset {
namespace {

using detail::LineReader;

// Of a virtual baseline of 40 / 525 m, about that between a Kinect's projector and its camera.
double virtual_bf(double fx) { return 40.0 * fx / 525.0; }

constexpr double kTumDepthScale = 5000.0;
constexpr double kKinectFps = 30.0;

CameraFile kinect(double fx, double fy, double cx, double cy, const Distortion& distortion) {
  CameraFile file;
  file.camera.fx = fx;
  file.camera.fy = fy;
  file.camera.cx = cx;
  file.camera.cy = cy;
  file.camera.width = 640;
  file.camera.height = 480;
  file.camera.bf = virtual_bf(fx);
  file.distortion = distortion;
  file.fps = kKinectFps;
  file.depth_scale = kTumDepthScale;
  return file;
}

int to_pixels(const LineReader& reader, std::string_view key, double value) {
  constexpr double kLargest = 65535.0;
  if (!(value >= 1.0 && value <= kLargest && value == std::floor(value))) {
    reader.fail(std::string(key) + " is " + std::to_string(value) +
                ", expected a whole number of pixels from 1 to 65535");
  }
  return static_cast<int>(value);
}

// One number of camera.txt, checked by itself.
class CameraKeys {
 public:
  explicit CameraKeys(const LineReader& reader) : reader_(reader) {}

  void set(std::string_view key, double value) {
    DepthCamera& camera = file.camera;
    if (key == "fx") {
      store(key, positive(key, value), &camera.fx, &has_fx);
    } else if (key == "fy") {
      store(key, positive(key, value), &camera.fy, &has_fy);
    } else if (key == "cx") {
      store(key, value, &camera.cx, &has_cx);
    } else if (key == "cy") {
      store(key, value, &camera.cy, &has_cy);
    } else if (key == "width") {
      store(key, to_pixels(reader_, key, value), &camera.width, &has_width_);
    } else if (key == "height") {
      store(key, to_pixels(reader_, key, value), &camera.height, &has_height_);
    } else if (key == "bf") {
      store(key, positive(key, value), &camera.bf, &has_bf);
    } else if (key == "fps") {
      store_optional(key, positive(key, value), &file.fps);
    } else if (key == "depth_scale") {
      store_optional(key, positive(key, value), &file.depth_scale);
    } else if (!set_distortion(key, value)) {
      reader_.fail("unknown key " + detail::quoted(key) +
                   ", expected fx fy cx cy width height fps depth_scale bf k1 k2 p1 p2 k3");
    }
  }

  CameraFile file;
  bool has_fx = false, has_fy = false, has_cx = false, has_cy = false, has_bf = false;

 private:
  bool set_distortion(std::string_view key, double value) {
    constexpr std::string_view kKeys[] = {"k1", "k2", "p1", "p2", "k3"};
    for (std::size_t i = 0; i < file.distortion.size(); ++i) {
      if (key == kKeys[i]) {
        store(key, value, &file.distortion[i], &has_distortion_[i]);
        return true;
      }
    }
    return false;
  }
  double positive(std::string_view key, double value) const {
    if (!(value > 0.0)) {
      reader_.fail(std::string(key) + " is " + std::to_string(value) +
                   ", expected a positive number");
    }
    return value;
  }
  void refuse_twice(std::string_view key, bool had) const {
    if (had) reader_.fail(std::string(key) + " is given twice, expected it once");
  }
  template <typename T>
  void store(std::string_view key, T value, T* target, bool* has) {
    refuse_twice(key, *has);
    *target = value;
    *has = true;
  }
  void store_optional(std::string_view key, double value, std::optional<double>* target) {
    refuse_twice(key, target->has_value());
    *target = value;
  }

  const LineReader& reader_;
  bool has_width_ = false, has_height_ = false;
  std::array<bool, 5> has_distortion_{};
};

}  // namespace

std::vector<ImageRow> parse_tum_images(std::string_view text, std::string_view path) {
  LineReader reader(text, path);
  std::vector<ImageRow> rows;
  while (reader.next()) {
    reader.expect_fields(2, "2: time and file");
    rows.push_back({reader.number(0, "the time"), std::string(reader.fields()[1]), reader.line()});
  }
  return rows;
}

std::vector<AssociationRow> parse_tum_associations(std::string_view text, std::string_view path) {
  LineReader reader(text, path);
  std::vector<AssociationRow> rows;
  while (reader.next()) {
    reader.expect_fields(4, "4: time, colour file, time, depth file");
    AssociationRow row;
    row.color = {reader.number(0, "the colour image's time"), std::string(reader.fields()[1]),
                 reader.line()};
    row.depth = {reader.number(2, "the depth image's time"), std::string(reader.fields()[3]),
                 reader.line()};
    rows.push_back(std::move(row));
  }
  return rows;
}

std::vector<PoseRow> parse_tum_poses(std::string_view text, std::string_view path) {
  LineReader reader(text, path);
  std::vector<PoseRow> rows;
  while (reader.next()) {
    reader.expect_fields(8, "8: time tx ty tz qx qy qz qw");
    const Eigen::Vector3d t(reader.number(1, "tx"), reader.number(2, "ty"), reader.number(3, "tz"));
    const Eigen::Vector4d xyzw(reader.number(4, "qx"), reader.number(5, "qy"),
                               reader.number(6, "qz"), reader.number(7, "qw"));
    rows.push_back(
        {{reader.number(0, "the time"), detail::pose_from(reader, t, xyzw)}, reader.line()});
  }
  return rows;
}

CameraFile parse_camera(std::string_view text, std::string_view path) {
  LineReader reader(text, path);
  CameraKeys keys(reader);
  while (reader.next()) {
    if (reader.fields().size() % 2 != 0) {
      reader.fail(
          "got an odd number of fields, expected pairs of key and number such as \"fx 525\"");
    }
    for (std::size_t i = 0; i < reader.fields().size(); i += 2) {
      const std::string_view key = reader.fields()[i];
      keys.set(key, reader.number(i + 1, detail::quoted(key)));
    }
  }
  if (!keys.has_fx || !keys.has_fy || !keys.has_cx || !keys.has_cy) {
    throw_io_error(path, "the camera is incomplete, expected at least fx, fy, cx and cy");
  }
  if (!keys.has_bf) keys.file.camera.bf = virtual_bf(keys.file.camera.fx);
  return keys.file;
}

std::optional<CameraFile> known_tum_camera(std::string_view folder_name) {
  const auto holds = [&](std::string_view part) { return folder_name.find(part) != part.npos; };
  // Published with the benchmarks: TUM RGB-D, "Intrinsic Camera Calibration of the Kinect"; Bonn
  // RGB-D Dynamic Dataset.
  if (holds("freiburg1")) {
    return kinect(517.3, 516.5, 318.6, 255.3, {0.2624, -0.9531, -0.0054, 0.0026, 1.1633});
  }
  if (holds("freiburg2")) {
    return kinect(520.9, 521.0, 325.1, 249.7, {0.2312, -0.7849, -0.0033, -0.0001, 0.9172});
  }
  if (holds("freiburg3")) return kinect(535.4, 539.2, 320.1, 247.6, {});
  if (folder_name.substr(0, 10) == "rgbd_bonn_") {
    return kinect(542.822841, 542.576870, 315.593520, 237.756098,
                  {0.039903, -0.099343, -0.000730, -0.000144, 0.0});
  }
  return std::nullopt;
}

}  // namespace dynslam::dataset
