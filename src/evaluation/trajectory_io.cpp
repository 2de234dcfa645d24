#include "dynslam/evaluation/trajectory_io.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include <Eigen/SVD>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

#include "evaluation/trajectory_checks.hpp"

namespace dynslam::evaluation {
namespace {

constexpr std::size_t kTumColumns = 8;
constexpr std::size_t kKittiColumns = 12;
constexpr const char* kTumRow = "8 numbers (TUM: time tx ty tz qx qy qz qw)";
constexpr const char* kKittiRow = "12 numbers (KITTI: a 3x4 matrix by rows)";

// Where a row stands, for messages.
struct Place {
  const std::string& path;
  std::size_t line;
};

[[noreturn]] void fail(const Place& place, const std::string& what, const std::string& expected) {
  throw_io_error(place.path + ":" + std::to_string(place.line), what + ", expected " + expected);
}

std::string number_text(double value) {
  char buffer[400];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, value).ptr;
  return std::string(buffer, end);
}

// A piece of a foreign file, fit for a message.
std::string quoted(std::string_view token) {
  std::string text = "\"";
  for (const char c : token.substr(0, 24)) text += (c >= ' ' && c <= '~') ? c : '?';
  return text + (token.size() > 24 ? "...\"" : "\"");
}

bool is_separator(char c) { return c == ' ' || c == '\t' || c == ',' || c == '\r'; }

double parse_number(std::string_view token, const Place& place) {
  std::string_view digits = token;
  // from_chars takes no plus sign; a file may have one.
  if (digits.size() > 1 && digits[0] == '+' && digits[1] != '-') digits.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error == std::errc::result_out_of_range) {
    fail(place, quoted(token) + " is out of range", "a number that fits a double");
  }
  if (error != std::errc() || end != digits.data() + digits.size()) {
    fail(place, quoted(token) + " is not a number", "numbers separated by blanks or commas");
  }
  if (!std::isfinite(value)) fail(place, quoted(token) + " is not finite", "finite numbers");
  return value;
}

// One row of numbers of a file.
struct Row {
  std::array<double, kKittiColumns> values{};
  std::size_t count = 0;  // may exceed the array; the numbers beyond are not kept
  std::size_t line = 0;
};

Row parse_row(std::string_view line, const Place& place) {
  Row row;
  row.line = place.line;
  std::size_t at = 0;
  while (true) {
    while (at < line.size() && is_separator(line[at])) ++at;
    if (at == line.size()) return row;
    std::size_t end = at;
    while (end < line.size() && !is_separator(line[end])) ++end;
    const double value = parse_number(line.substr(at, end - at), place);
    if (row.count < row.values.size()) row.values[row.count] = value;
    ++row.count;
    at = end;
  }
}

// Calls visit(row) for every line that holds numbers.
template <typename Visit>
void for_each_row(std::string_view text, const std::string& path, Visit&& visit) {
  if (text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);  // byte order mark
  for (std::size_t line = 1; !text.empty(); ++line) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view content = text.substr(0, end);
    content = content.substr(0, content.find('#'));
    const Row row = parse_row(content, {path, line});
    if (row.count > 0) visit(row);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
}

std::string count_text(std::size_t count) {
  return std::to_string(count) + (count == 1 ? " number" : " numbers");
}

TrajectoryFormat detect_format(const Row& row, const Place& place) {
  if (row.count == kTumColumns) return TrajectoryFormat::kTum;
  if (row.count == kKittiColumns) return TrajectoryFormat::kKitti;
  fail(place, count_text(row.count), std::string(kTumRow) + " or " + kKittiRow);
}

RigidTransform tum_pose(const Row& row, double tolerance, const Place& place) {
  const auto& v = row.values;
  const Eigen::Quaterniond q(v[7], v[4], v[5], v[6]);
  const double norm = q.norm();
  if (norm < 1e-12) fail(place, "zero quaternion", "a unit quaternion qx qy qz qw");
  if (!(std::abs(norm - 1.0) <= tolerance)) {
    fail(place, "quaternion of length " + number_text(norm),
         "a unit quaternion qx qy qz qw (within " + number_text(tolerance) + ")");
  }
  return {q, Eigen::Vector3d(v[1], v[2], v[3])};
}

RigidTransform kitti_pose(const Row& row, double tolerance, const Place& place) {
  const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> m(row.values.data());
  const Eigen::Matrix3d R = m.leftCols<3>();
  const Eigen::Matrix3d deviation = R.transpose() * R - Eigen::Matrix3d::Identity();
  const double largest = deviation.cwiseAbs().maxCoeff();
  if (!(largest <= tolerance) || R.determinant() <= 0.0) {
    fail(place, "a matrix that is no rotation (R^T R - I has " + number_text(largest) + ")",
         "columns 1 2 3, 5 6 7, 9 10 11 to be a rotation (within " + number_text(tolerance) + ")");
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d, Eigen::NoQRPreconditioner> svd(
      R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return {Eigen::Matrix3d(svd.matrixU() * svd.matrixV().transpose()), m.col(3)};
}

// Poses (or times alone) with the lines they came from.
struct Lines {
  Trajectory poses;
  std::vector<std::size_t> lines;

  void add(double timestamp, const RigidTransform& T_world_cam, std::size_t line) {
    poses.push_back({timestamp, T_world_cam});
    lines.push_back(line);
  }
};

void sort_by_time(Lines& read) {
  std::vector<std::size_t> order(read.poses.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return read.poses[a].timestamp < read.poses[b].timestamp;
  });
  Lines sorted;
  for (const std::size_t i : order) {
    sorted.add(read.poses[i].timestamp, read.poses[i].T_world_cam, read.lines[i]);
  }
  read = std::move(sorted);
}

void drop_repeated(Lines& read) {
  Lines kept;
  for (std::size_t i = 0; i < read.poses.size(); ++i) {
    const StampedPose& pose = read.poses[i];
    if (!kept.poses.empty() && kept.poses.back().timestamp == pose.timestamp) continue;
    kept.add(pose.timestamp, pose.T_world_cam, read.lines[i]);
  }
  read = std::move(kept);
}

void require_order(const Lines& read, const std::string& path) {
  for (std::size_t i = 1; i < read.poses.size(); ++i) {
    const double before = read.poses[i - 1].timestamp;
    const double now = read.poses[i].timestamp;
    if (now > before) continue;
    const std::string other = "line " + std::to_string(read.lines[i - 1]);
    const Place place{path, read.lines[i]};
    if (now == before) {
      fail(place, "timestamp " + number_text(now) + " repeats that of " + other,
           "every timestamp once (reading with drop_repeated keeps the first)");
    }
    fail(place,
         "timestamp " + number_text(now) + " runs behind " + number_text(before) + " of " + other,
         "increasing timestamps (reading with the option sort puts them in order)");
  }
}

std::vector<double> read_times(const std::string& path, std::vector<std::size_t>& lines) {
  std::vector<double> times;
  for_each_row(read_file(path), path, [&](const Row& row) {
    if (row.count != 1) fail({path, row.line}, count_text(row.count), "one timestamp in seconds");
    times.push_back(row.values[0]);
    lines.push_back(row.line);
  });
  return times;
}

// Gives KITTI poses their times; the lines named in messages are then those of the times.
void take_times(const ReadTrajectoryOptions& options, const std::string& name, Lines& read) {
  std::vector<std::size_t> lines;
  const std::vector<double> times = read_times(options.times_path, lines);
  if (times.size() != read.poses.size()) {
    throw_io_error(options.times_path, std::to_string(times.size()) + " timestamps, expected " +
                                           std::to_string(read.poses.size()) +
                                           ", one for each pose of " + name);
  }
  for (std::size_t i = 0; i < times.size(); ++i) read.poses[i].timestamp = times[i];
  read.lines = std::move(lines);
}

void append_fixed(std::string& text, double value, int decimals) {
  char buffer[400];
  const auto result =
      decimals >= 0
          ? std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::fixed, decimals)
          : std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::fixed);
  text.append(buffer, result.ptr);
}

void append_tum(std::string& text, const StampedPose& pose) {
  const Eigen::Quaterniond q = pose.T_world_cam.quaternion();
  const Eigen::Vector3d& t = pose.T_world_cam.t;
  append_fixed(text, pose.timestamp, -1);
  for (const double v : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) {
    text += ' ';
    append_fixed(text, v, 9);
  }
  text += '\n';
}

void append_kitti(std::string& text, const RigidTransform& T_world_cam) {
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) {
      append_fixed(text, c < 3 ? T_world_cam.R(r, c) : T_world_cam.t(r), 9);
      text += (r == 2 && c == 3) ? '\n' : ' ';
    }
  }
}

}  // namespace

void ReadTrajectoryOptions::validate() const {
  constexpr const char* where = "ReadTrajectoryOptions";
  require(rotation_tolerance >= 0.0 && rotation_tolerance <= 0.5, where, "rotation_tolerance",
          rotation_tolerance, "a value in [0, 0.5]");
  require(times_path.empty() || format != TrajectoryFormat::kTum, where, "times_path", times_path,
          "nothing with the format TUM, whose rows have timestamps");
}

Trajectory parse_trajectory(std::string_view text, const std::string& name,
                            const ReadTrajectoryOptions& options) {
  options.validate();
  TrajectoryFormat format = options.format;
  Lines read;
  for_each_row(text, name, [&](const Row& row) {
    const Place place{name, row.line};
    if (format == TrajectoryFormat::kAuto) format = detect_format(row, place);
    const bool tum = format == TrajectoryFormat::kTum;
    if (row.count != (tum ? kTumColumns : kKittiColumns)) {
      fail(place, count_text(row.count), tum ? kTumRow : kKittiRow);
    }
    if (tum) {
      read.add(row.values[0], tum_pose(row, options.rotation_tolerance, place), row.line);
    } else {
      read.add(static_cast<double>(read.poses.size()),
               kitti_pose(row, options.rotation_tolerance, place), row.line);
    }
  });
  if (read.poses.empty()) throw_io_error(name, "no poses, expected at least one row of numbers");
  const bool times = !options.times_path.empty();
  if (times && format == TrajectoryFormat::kTum) {
    throw_io_error(name, "rows of 8 numbers (TUM), expected KITTI poses for the times of " +
                             options.times_path);
  }
  if (times) take_times(options, name, read);
  if (options.sort) sort_by_time(read);
  if (options.drop_repeated) drop_repeated(read);
  require_order(read, times ? options.times_path : name);
  return std::move(read.poses);
}

Trajectory read_trajectory(const std::string& path, const ReadTrajectoryOptions& options) {
  options.validate();
  return parse_trajectory(read_file(path), path, options);
}

void write_trajectory(const std::string& path, Span<const StampedPose> trajectory,
                      TrajectoryFormat format) {
  require(format != TrajectoryFormat::kAuto, "write_trajectory", "format", "kAuto",
          "kTum or kKitti");
  const bool tum = format == TrajectoryFormat::kTum;
  std::string text = tum ? "# timestamp tx ty tz qx qy qz qw\n" : "";
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    const StampedPose& pose = trajectory[i];
    require(pose.T_world_cam.all_finite() && (!tum || std::isfinite(pose.timestamp)),
            "write_trajectory", "trajectory[" + std::to_string(i) + "]", "NaN or infinity",
            "finite poses and timestamps");
    if (tum) {
      append_tum(text, pose);
    } else {
      append_kitti(text, pose.T_world_cam);
    }
  }
  write_file_atomically(path, text);
}

void write_times(const std::string& path, Span<const StampedPose> trajectory) {
  std::string text;
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    require(std::isfinite(trajectory[i].timestamp), "write_times",
            "trajectory[" + std::to_string(i) + "].timestamp", trajectory[i].timestamp,
            "a finite timestamp");
    append_fixed(text, trajectory[i].timestamp, -1);
    text += '\n';
  }
  write_file_atomically(path, text);
}

}  // namespace dynslam::evaluation
