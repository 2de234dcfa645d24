#include "evaluation/file_io.hpp"

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <system_error>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::evaluation {
namespace {

[[noreturn]] void throw_system_error(const std::string& path, const char* what, int error) {
  throw_io_error(path, std::string(what) + ": " + std::generic_category().message(error));
}

// A file descriptor that is closed when its owner goes.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  int get() const { return fd_; }
  // Closes now; 0 or the error, which a network file system may report only here.
  int close() {
    const int fd = fd_;
    fd_ = -1;
    return ::close(fd) == 0 ? 0 : errno;
  }

 private:
  int fd_;
};

int write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno != EINTR) return errno;
    if (n > 0) bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return 0;
}

// A disk that is full may say so only when the data is really put there.
int flush_to_disk(int fd) {
  if (::fsync(fd) == 0 || errno == EINVAL || errno == EROFS || errno == ENOTSUP) return 0;
  return errno;
}

void write_in_place(const std::string& path, std::string_view bytes) {
  Descriptor file(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
  if (file.get() < 0) throw_system_error(path, "cannot be opened for writing", errno);
  int error = write_all(file.get(), bytes);
  if (error == 0) error = file.close();
  if (error != 0) throw_system_error(path, "cannot be written", error);
}

std::string temporary_name(const std::string& path) {
  static std::atomic<unsigned> counter{0};
  return path + ".tmp" + std::to_string(::getpid()) + "_" + std::to_string(counter++);
}

}  // namespace

std::string read_file(const std::string& path) {
  Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) throw_system_error(path, "cannot be opened for reading", errno);
  std::string bytes;
  std::size_t used = 0;
  for (;;) {
    if (used == bytes.size()) bytes.resize(bytes.empty() ? 65536 : 2 * bytes.size());
    const ssize_t n = ::read(file.get(), bytes.data() + used, bytes.size() - used);
    if (n == 0) break;
    if (n < 0 && errno != EINTR) throw_system_error(path, "cannot be read", errno);
    if (n > 0) used += static_cast<std::size_t>(n);
  }
  bytes.resize(used);
  return bytes;
}

void write_file_atomically(const std::string& path, std::string_view bytes) {
  std::error_code ignored;
  std::string target = path;
  if (std::filesystem::is_symlink(path, ignored)) {
    const auto real = std::filesystem::weakly_canonical(path, ignored);
    if (!ignored) target = real.string();
  }
  struct stat info {};
  if (::stat(target.c_str(), &info) == 0 && !S_ISREG(info.st_mode)) {
    if (S_ISDIR(info.st_mode)) throw_io_error(path, "cannot be written: it is a folder");
    return write_in_place(target, bytes);
  }
  const std::string temporary = temporary_name(target);
  Descriptor file(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666));
  if (file.get() < 0) throw_system_error(path, "cannot be written", errno);
  int error = write_all(file.get(), bytes);
  if (error == 0) error = flush_to_disk(file.get());
  if (const int close_error = file.close(); error == 0) error = close_error;
  if (error == 0 && std::rename(temporary.c_str(), target.c_str()) != 0) error = errno;
  if (error != 0) {
    ::unlink(temporary.c_str());
    throw_system_error(path, "cannot be written", error);
  }
}

}  // namespace dynslam::evaluation
