// Line by line reading of text formats, with errors that name path and line. Internal.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "dynslam/core/rigid_transform.hpp"

namespace dynslam::dataset::detail {

/// Throws IoError "path:line: what".
[[noreturn]] void fail_at_line(std::string_view path, std::size_t line, std::string_view what);

/// A field of foreign text as it may stand in a message: quoted, shortened, printable.
std::string quoted(std::string_view field);

/// Reads a finite number that fills `field`, whatever the locale. False if it does not.
bool to_number(std::string_view field, double* value);

/// Goes over the lines that mean something and splits them into fields.
class LineReader {
 public:
  /// Fields are separated by blanks, or by `separator` with blanks around them.
  LineReader(std::string_view text, std::string_view path, char separator = ' ');

  /// Goes to the next line that is neither blank nor a comment. False at the end.
  bool next();

  const std::vector<std::string_view>& fields() const { return fields_; }
  std::size_t line() const { return line_; }

  /// Throws unless the line has `count` fields; `form` says what was expected.
  void expect_fields(std::size_t count, std::string_view form) const;
  /// Field `i`, which exists, as a finite number; throws naming `what` otherwise.
  double number(std::size_t i, std::string_view what) const;
  /// Field `i` as nanoseconds, returned in seconds.
  double nanoseconds(std::size_t i, std::string_view what) const;
  [[noreturn]] void fail(std::string_view what) const { fail_at_line(path_, line_, what); }

 private:
  void split(std::string_view line);

  std::string_view rest_;
  std::string_view path_;
  char separator_;
  std::size_t line_ = 0;
  std::vector<std::string_view> fields_;
};

/// Pose from a translation and a quaternion (x, y, z, w) whose norm must be within 0.05 of 1;
/// throws by the reader otherwise.
RigidTransform pose_from(const LineReader& reader, const Eigen::Vector3d& t,
                         const Eigen::Vector4d& xyzw);

}  // namespace dynslam::dataset::detail
