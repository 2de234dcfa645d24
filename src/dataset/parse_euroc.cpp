#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

#include "dataset/text.hpp"

namespace dynslam::dataset {
namespace {

using detail::LineReader;

std::string_view trimmed(std::string_view s) {
  constexpr std::string_view kBlanks = " \t\r\v\f\n";
  const std::size_t first = s.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return s.substr(first, s.find_last_not_of(kBlanks) - first + 1);
}

std::string_view without_comment(std::string_view line) { return line.substr(0, line.find('#')); }

// The part of YAML in which sensor.yaml is written: "key: value", values that are words or lists of
// numbers "[a, b, ...]" over one or several lines, and one level of indented keys.
class SensorYaml {
 public:
  SensorYaml(std::string_view text, std::string_view path) : rest_(text), path_(path) {}

  // Goes to the next "key: value". A list is complete in `value()`.
  bool next() {
    std::string_view line;
    while (take_line(&line)) {
      const std::string_view meaning = trimmed(without_comment(line));
      const std::size_t colon = meaning.find(':');
      if (meaning.empty() || meaning.front() == '%' || meaning.substr(0, 3) == "---" ||
          colon == std::string_view::npos) {
        continue;
      }
      const bool indented = line.front() == ' ' || line.front() == '\t';
      const std::string_view key = trimmed(meaning.substr(0, colon));
      if (!indented) section_ = key;
      key_ = indented ? std::string(section_) + "." + std::string(key) : std::string(key);
      key_line_ = line_;
      value_ = trimmed(meaning.substr(colon + 1));
      complete_list();
      return true;
    }
    return false;
  }

  const std::string& key() const { return key_; }
  const std::string& value() const { return value_; }
  [[noreturn]] void fail(std::string_view what) const {
    detail::fail_at_line(path_, key_line_, key_ + ": " + std::string(what));
  }

  double number() const {
    double value = 0.0;
    if (!detail::to_number(value_, &value)) {
      fail("got " + detail::quoted(value_) + ", expected a finite number");
    }
    return value;
  }

  std::vector<double> list(std::size_t least, std::size_t most) const {
    std::string_view inside(value_);
    if (inside.size() < 2 || inside.front() != '[' || inside.back() != ']') {
      fail("got " + detail::quoted(value_) + ", expected a list \"[a, b, ...]\"");
    }
    inside = inside.substr(1, inside.size() - 2);
    std::vector<double> numbers;
    while (numbers.size() <= most) {
      const std::size_t end = inside.find(',');
      double value = 0.0;
      if (!detail::to_number(trimmed(inside.substr(0, end)), &value)) {
        fail("got " + detail::quoted(trimmed(inside.substr(0, end))) + ", expected finite numbers");
      }
      numbers.push_back(value);
      if (end == std::string_view::npos) break;
      inside.remove_prefix(end + 1);
    }
    if (numbers.size() < least || numbers.size() > most) {
      fail("the list has another length, expected " + std::to_string(least) +
           (most > least ? " to " + std::to_string(most) : std::string()) + " numbers");
    }
    return numbers;
  }

 private:
  bool take_line(std::string_view* line) {
    if (rest_.empty()) return false;
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    *line = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    ++line_;
    if (line->empty()) *line = " ";
    return true;
  }

  // Looks for the end in new lines only: a list may have many of them.
  void complete_list() {
    if (value_.empty() || value_.front() != '[') return;
    std::size_t looked_at = 0;
    std::string_view line;
    while (value_.find(']', looked_at) == std::string::npos) {
      looked_at = value_.size();
      if (!take_line(&line)) fail("the list does not end, expected \"]\"");
      value_ += ' ';
      value_ += trimmed(without_comment(line));
    }
    value_.resize(value_.find(']', looked_at) + 1);
  }

  std::string_view rest_;
  std::string_view path_;
  std::string_view section_;
  std::string key_;
  std::string value_;
  std::size_t line_ = 0;
  std::size_t key_line_ = 0;
};

RigidTransform transform_from(const SensorYaml& yaml) {
  constexpr double kLargestDefect = 1e-3;
  const std::vector<double> v = yaml.list(16, 16);
  const Eigen::Matrix4d m =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(v.data());
  const Eigen::Matrix3d R = m.topLeftCorner<3, 3>();
  const bool rigid = (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() <= kLargestDefect &&
                     R.determinant() > 0.0 &&
                     (m.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).norm() <= kLargestDefect;
  if (!rigid) yaml.fail("the matrix is no rigid motion, expected [R t; 0 1] by rows");
  return RigidTransform(R, m.topRightCorner<3, 1>()).normalized();
}

void read_resolution(const SensorYaml& yaml, DepthCamera* camera) {
  constexpr double kLargest = 65535.0;
  const std::vector<double> v = yaml.list(2, 2);
  for (const double n : v) {
    if (!(n >= 1.0 && n <= kLargest && n == std::floor(n))) {
      yaml.fail("got " + std::to_string(n) + ", expected whole numbers of pixels from 1 to 65535");
    }
  }
  camera->width = static_cast<int>(v[0]);
  camera->height = static_cast<int>(v[1]);
}

void read_intrinsics(const SensorYaml& yaml, DepthCamera* camera) {
  const std::vector<double> v = yaml.list(4, 4);
  if (!(v[0] > 0.0 && v[1] > 0.0))
    yaml.fail("the focal lengths are not positive, expected fx fy cx cy");
  camera->fx = v[0];
  camera->fy = v[1];
  camera->cx = v[2];
  camera->cy = v[3];
}

void expect_word(const SensorYaml& yaml, std::string_view one, std::string_view other) {
  if (yaml.value() != one && yaml.value() != other) {
    yaml.fail("got " + detail::quoted(yaml.value()) + ", expected " + std::string(one));
  }
}

}  // namespace

std::vector<ImageRow> parse_euroc_images(std::string_view text, std::string_view path) {
  LineReader reader(text, path, ',');
  std::vector<ImageRow> rows;
  while (reader.next()) {
    reader.expect_fields(2, "2: time in ns, file");
    if (reader.fields()[1].empty()) reader.fail("the file's name is empty, expected one");
    rows.push_back(
        {reader.nanoseconds(0, "the time"), std::string(reader.fields()[1]), reader.line()});
  }
  return rows;
}

std::vector<PoseRow> parse_euroc_poses(std::string_view text, std::string_view path) {
  LineReader reader(text, path, ',');
  std::vector<PoseRow> rows;
  while (reader.next()) {
    if (reader.fields().size() < 8) {
      reader.expect_fields(8, "at least 8: time in ns, px, py, pz, qw, qx, qy, qz");
    }
    const Eigen::Vector3d t(reader.number(1, "px"), reader.number(2, "py"), reader.number(3, "pz"));
    const Eigen::Vector4d xyzw(reader.number(5, "qx"), reader.number(6, "qy"),
                               reader.number(7, "qz"), reader.number(4, "qw"));
    rows.push_back(
        {{reader.nanoseconds(0, "the time"), detail::pose_from(reader, t, xyzw)}, reader.line()});
  }
  return rows;
}

EurocCamera parse_euroc_camera(std::string_view text, std::string_view path) {
  SensorYaml yaml(text, path);
  EurocCamera sensor;
  bool has_intrinsics = false, has_resolution = false, has_pose = false;
  while (yaml.next()) {
    if (yaml.key() == "T_BS.data") {
      sensor.T_body_cam = transform_from(yaml);
      has_pose = true;
    } else if (yaml.key() == "resolution") {
      read_resolution(yaml, &sensor.file.camera);
      has_resolution = true;
    } else if (yaml.key() == "intrinsics") {
      read_intrinsics(yaml, &sensor.file.camera);
      has_intrinsics = true;
    } else if (yaml.key() == "rate_hz") {
      sensor.file.fps = yaml.number();
      if (!(*sensor.file.fps > 0.0))
        yaml.fail("got " + yaml.value() + ", expected a positive number");
    } else if (yaml.key() == "camera_model") {
      expect_word(yaml, "pinhole", "pinhole");
    } else if (yaml.key() == "distortion_model") {
      expect_word(yaml, "radial-tangential", "radtan");
    } else if (yaml.key() == "distortion_coefficients") {
      const std::vector<double> v = yaml.list(4, 5);
      std::copy(v.begin(), v.end(), sensor.file.distortion.begin());
    }
  }
  if (!has_intrinsics || !has_resolution || !has_pose) {
    throw_io_error(path, "the camera is incomplete, expected T_BS, resolution and intrinsics");
  }
  return sensor;
}

}  // namespace dynslam::dataset
