// Errors of the library.
//
// A broken contract (wrong shape, invalid option, unreadable or corrupt file)
// throws one of the two types below; outputs are then untouched. An unlucky
// frame (too few matches, no loop, a point behind the camera) is never an
// exception but a value in the result.
#pragma once

#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

namespace dynslam {

/// Base of everything dynslam throws itself.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The caller broke the contract of a function: wrong shape, invalid option,
/// NaN where none may be.
class InvalidArgument : public Error {
 public:
  using Error::Error;
};

/// A file or folder cannot be read or written, or its content is not what it
/// claims to be.
class IoError : public Error {
 public:
  using Error::Error;
};

namespace detail {

template <typename T>
std::string to_text(const T& value) {
  if constexpr (std::is_convertible_v<const T&, std::string_view>) {
    return std::string(std::string_view(value));
  } else {
    return std::to_string(value);
  }
}

}  // namespace detail

/// Throws InvalidArgument: "function: parameter: got X, expected Y".
template <typename Got, typename Expected>
[[noreturn]] void throw_invalid_argument(std::string_view function, std::string_view parameter,
                                         const Got& got, const Expected& expected) {
  throw InvalidArgument(std::string(function) + ": " + std::string(parameter) + ": got " +
                        detail::to_text(got) + ", expected " + detail::to_text(expected));
}

/// Throws InvalidArgument unless `condition` holds.
///
/// The message is only built on failure, so a check may stand in a hot
/// function.
template <typename Got, typename Expected>
void require(bool condition, std::string_view function, std::string_view parameter, const Got& got,
             const Expected& expected) {
  if (!condition) throw_invalid_argument(function, parameter, got, expected);
}

/// Throws IoError: "path: what".
[[noreturn]] inline void throw_io_error(std::string_view path, std::string_view what) {
  throw IoError(std::string(path) + ": " + std::string(what));
}

}  // namespace dynslam
