// Whole files in and out.
#pragma once

#include <atomic>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam {

/// A file that appears under its name complete or not at all.
///
/// Bytes go to another name in the same folder; `commit` forces them to the disk and renames. Until
/// then an older file stays as it was, and without a commit what was written is removed. A symbolic
/// link stays one and its target is replaced; a device or pipe is written directly. Members throw
/// IoError with the path and the system's reason (a full disk is one). One thread at a time;
/// several objects may write the same path, and the last to commit wins.
class AtomicFile {
 public:
  explicit AtomicFile(std::string path) : path_(std::move(path)) {
    std::error_code error;
    std::filesystem::path target = path_;
    if (std::filesystem::is_symlink(path_, error)) {
      const auto real = std::filesystem::weakly_canonical(path_, error);
      if (!error) target = real;
    }
    target_ = target.string();
    struct stat info {};
    int flags = O_WRONLY | O_CLOEXEC;
    std::string opened = target_;
    if (::stat(target_.c_str(), &info) != 0 || S_ISREG(info.st_mode)) {
      temporary_ = temporary_name(target_);
      opened = temporary_;
      flags |= O_CREAT | O_EXCL;
    } else if (S_ISDIR(info.st_mode)) {
      throw_io_error(path_, "cannot be written: it is a folder");
    }
    file_ = ::open(opened.c_str(), flags, 0666);
    if (file_ < 0) {
      temporary_.clear();
      fail(errno);
    }
  }
  ~AtomicFile() { discard(); }
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Appends bytes. Small pieces are collected.
  void write(std::string_view bytes) {
    if (waiting_.size() + bytes.size() > kBuffer) flush();
    if (bytes.size() > kBuffer) {
      put(bytes);
    } else {
      waiting_.append(bytes);
    }
  }
  void write(const void* bytes, std::size_t size) {
    write(std::string_view(static_cast<const char*>(bytes), size));
  }

  /// Gives the file its name; nothing may follow. `durable` waits for the disk first, so that even
  /// after a loss of power the name leads to all of it.
  void commit(bool durable = true) {
    flush();
    if (durable && ::fsync(file_) != 0 && errno != EINVAL && errno != EROFS && errno != ENOTSUP) {
      fail(errno);
    }
    const int file = std::exchange(file_, -1);
    // A network file system may report only here that the disk is full.
    if (::close(file) != 0) fail(errno);
    if (!temporary_.empty() && std::rename(temporary_.c_str(), target_.c_str()) != 0) fail(errno);
    temporary_.clear();
  }

  /// The open file, for libraries that write to descriptors themselves instead of `write`. Not to
  /// be closed.
  int descriptor() const { return file_; }

  /// Removes what was written and throws IoError with the reason of a system error.
  [[noreturn]] void fail(int error) {
    discard();
    throw_io_error(path_, "cannot be written: " + std::generic_category().message(error));
  }

 private:
  static constexpr std::size_t kBuffer = 65536;

  void put(std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t n = ::write(file_, bytes.data(), bytes.size());
      if (n < 0 && errno != EINTR) fail(errno);
      if (n > 0) bytes.remove_prefix(static_cast<std::size_t>(n));
    }
  }
  void flush() {
    put(waiting_);
    waiting_.clear();
  }
  static std::string temporary_name(const std::string& path) {
    static std::atomic<unsigned> counter{0};
    return path + ".tmp" + std::to_string(::getpid()) + "_" + std::to_string(counter++);
  }
  void discard() {
    if (file_ >= 0) ::close(std::exchange(file_, -1));
    if (!temporary_.empty()) ::unlink(temporary_.c_str());
    temporary_.clear();
  }

  std::string path_;       // as the caller says
  std::string target_;     // without symbolic links
  std::string temporary_;  // empty: written directly, or done
  std::string waiting_;
  int file_ = -1;
};

/// Writes a whole file by AtomicFile. Throws IoError. O(bytes).
inline void write_file_atomically(const std::string& path, std::string_view bytes,
                                  bool durable = true) {
  AtomicFile file(path);
  file.write(bytes);
  file.commit(durable);
}

/// The bytes of a file, or of what a pipe delivers. Throws IoError if there is no such file, if it
/// is a folder, and with the system's reason if it cannot be read. O(bytes).
inline std::string read_file(const std::string& path) {
  const auto fail = [&](const char* what, int error) {
    throw_io_error(path, std::string(what) + ": " + std::generic_category().message(error));
  };
  struct Descriptor {
    int fd;
    ~Descriptor() {
      if (fd >= 0) ::close(fd);
    }
  } const file{::open(path.c_str(), O_RDONLY | O_CLOEXEC)};
  if (file.fd < 0 && errno == ENOENT) throw_io_error(path, "there is no such file");
  if (file.fd < 0) fail("cannot be opened for reading", errno);
  struct stat info {};
  if (::fstat(file.fd, &info) != 0) fail("cannot be read", errno);
  if (S_ISDIR(info.st_mode)) throw_io_error(path, "is a folder, not a file");
  std::string bytes;
  // One byte more than there are, so that the end is met without growing.
  if (S_ISREG(info.st_mode)) bytes.resize(static_cast<std::size_t>(info.st_size) + 1);
  std::size_t used = 0;
  for (;;) {
    if (used == bytes.size()) bytes.resize(bytes.empty() ? 65536 : 2 * bytes.size());
    const ssize_t n = ::read(file.fd, bytes.data() + used, bytes.size() - used);
    if (n == 0) break;
    if (n < 0 && errno != EINTR) fail("cannot be read", errno);
    if (n > 0) used += static_cast<std::size_t>(n);
  }
  bytes.resize(used);
  return bytes;
}

/// The same bytes for who counts in numbers; valid as long as `bytes` is.
inline Span<const std::uint8_t> as_bytes(std::string_view bytes) {
  return {reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()};
}

}  // namespace dynslam
