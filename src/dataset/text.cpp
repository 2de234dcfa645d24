#include "dataset/text.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>

#include "dynslam/core/errors.hpp"

namespace dynslam::dataset::detail {
namespace {

constexpr std::string_view kBlanks = " \t\r\v\f";

std::string_view trimmed(std::string_view s) {
  const std::size_t first = s.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return s.substr(first, s.find_last_not_of(kBlanks) - first + 1);
}

// std::from_chars does not take the plus sign that some tools write.
std::string_view without_plus(std::string_view s) {
  if (s.size() > 1 && s[0] == '+' && s[1] != '-' && s[1] != '+') s.remove_prefix(1);
  return s;
}

}  // namespace

void fail_at_line(std::string_view path, std::size_t line, std::string_view what) {
  throw_io_error(std::string(path) + ":" + std::to_string(line), what);
}

std::string quoted(std::string_view field) {
  constexpr std::size_t kLongest = 40;
  std::string text = "\"";
  for (const char c : field.substr(0, kLongest)) text += (c >= 32 && c < 127) ? c : '?';
  return text + (field.size() > kLongest ? "...\"" : "\"");
}

bool to_number(std::string_view field, double* value) {
  field = without_plus(field);
  double parsed = 0.0;
  const char* end = field.data() + field.size();
  const auto [stop, error] = std::from_chars(field.data(), end, parsed);
  if (stop != end || field.empty()) return false;
  // Too small to be told from zero is zero; too large is not a number we can use.
  const bool tiny = error == std::errc::result_out_of_range &&
                    (field.find("e-") != field.npos || field.find("E-") != field.npos);
  if (tiny) parsed = 0.0;
  if ((error != std::errc() && !tiny) || !std::isfinite(parsed)) return false;
  *value = parsed;
  return true;
}

LineReader::LineReader(std::string_view text, std::string_view path, char separator)
    : rest_(text), path_(path), separator_(separator) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (rest_.substr(0, kByteOrderMark.size()) == kByteOrderMark) {
    rest_.remove_prefix(kByteOrderMark.size());
  }
}

bool LineReader::next() {
  while (!rest_.empty()) {
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    const std::string_view line = trimmed(rest_.substr(0, end));
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    ++line_;
    if (line.empty() || line.front() == '#') continue;
    split(line);
    return true;
  }
  fields_.clear();
  return false;
}

void LineReader::split(std::string_view line) {
  fields_.clear();
  if (separator_ != ' ') {
    while (true) {
      const std::size_t end = line.find(separator_);
      fields_.push_back(trimmed(line.substr(0, end)));
      if (end == std::string_view::npos) return;
      line.remove_prefix(end + 1);
    }
  }
  while (!(line = trimmed(line)).empty()) {
    const std::size_t end = std::min(line.find_first_of(kBlanks), line.size());
    fields_.push_back(line.substr(0, end));
    line.remove_prefix(end);
  }
}

void LineReader::expect_fields(std::size_t count, std::string_view form) const {
  if (fields_.size() != count) {
    fail("got " + std::to_string(fields_.size()) + " fields, expected " + std::string(form));
  }
}

double LineReader::number(std::size_t i, std::string_view what) const {
  double value = 0.0;
  if (!to_number(fields_[i], &value)) {
    fail(std::string(what) + " is " + quoted(fields_[i]) + ", expected a finite number");
  }
  return value;
}

double LineReader::nanoseconds(std::size_t i, std::string_view what) const {
  const std::string_view field = without_plus(fields_[i]);
  std::int64_t value = 0;
  const char* end = field.data() + field.size();
  const auto [stop, error] = std::from_chars(field.data(), end, value);
  if (field.empty() || error != std::errc() || stop != end) {
    fail(std::string(what) + " is " + quoted(fields_[i]) + ", expected whole nanoseconds");
  }
  // Apart, because a double does not hold the nanoseconds of today to the nanosecond.
  constexpr std::int64_t kPerSecond = 1000000000;
  const std::int64_t whole = value / kPerSecond;
  return static_cast<double>(whole) + static_cast<double>(value - whole * kPerSecond) * 1e-9;
}

RigidTransform pose_from(const LineReader& reader, const Eigen::Vector3d& t,
                         const Eigen::Vector4d& xyzw) {
  constexpr double kSlack = 0.05;  // files round to four digits; more is another kind of column
  const double norm = xyzw.norm();
  if (!(std::abs(norm - 1.0) <= kSlack)) {
    reader.fail("the quaternion's norm is " + std::to_string(norm) + ", expected 1");
  }
  return {Eigen::Quaterniond(xyzw(3), xyzw(0), xyzw(1), xyzw(2)), t};
}

}  // namespace dynslam::dataset::detail
