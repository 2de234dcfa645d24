#include "evaluation/gnuplot.hpp"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <memory>
#include <system_error>

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace dynslam::evaluation {
namespace {

using Clock = std::chrono::steady_clock;

PlotResult failure(PlotStatus status, std::string problem) {
  PlotResult result;
  result.status = status;
  result.problem = std::move(problem);
  return result;
}

std::string reason(int error) { return std::generic_category().message(error); }

// A file without a name. As the child's input it needs no writing into a pipe, which could block or
// raise SIGPIPE in the host.
using UnnamedFile = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

UnnamedFile unnamed_file() {
  UnnamedFile file(std::tmpfile(), &std::fclose);
  if (file) ::fcntl(::fileno(file.get()), F_SETFD, FD_CLOEXEC);
  return file;
}

UnnamedFile unnamed_file(const std::string& content) {
  UnnamedFile file = unnamed_file();
  if (!file) return file;
  const bool written = std::fwrite(content.data(), 1, content.size(), file.get()) == content.size();
  if (!written || std::fflush(file.get()) != 0) file.reset();
  // The child shares the offset of the descriptor, so it is put back there.
  if (file && ::lseek(::fileno(file.get()), 0, SEEK_SET) != 0) file.reset();
  return file;
}

// The first line of what the child said on its standard error that is not blank or a caret.
std::string complaint(std::FILE* errors) {
  std::rewind(errors);
  char line[300];
  while (std::fgets(line, sizeof line, errors)) {
    std::string text(line);
    while (!text.empty() && (text.back() == '\n' || text.back() == ' ')) text.pop_back();
    if (text.find_first_not_of(" ^\t") != std::string::npos) return text;
  }
  return {};
}

// Starts `program -d -` with the given descriptors; 0 or the error.
int spawn(const std::string& program, int input, int output, int errors, pid_t& child) {
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, input, 0);
  posix_spawn_file_actions_adddup2(&files, output, 1);
  posix_spawn_file_actions_adddup2(&files, errors, 2);
  // The host's blocked and ignored signals are not the child's.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t none, pipe_signal;
  sigemptyset(&none);
  sigemptyset(&pipe_signal);
  sigaddset(&pipe_signal, SIGPIPE);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setsigdefault(&attributes, &pipe_signal);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
  std::string name = program, defaults = "-d", standard_input = "-";
  char* arguments[] = {name.data(), defaults.data(), standard_input.data(), nullptr};
  const int error =
      ::posix_spawnp(&child, program.c_str(), &files, &attributes, arguments, environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&files);
  return error;
}

enum class ReadEnd { kComplete, kTimeout, kError };

// Reads until the other side closes.
ReadEnd read_until_closed(int fd, double timeout, std::string& text) {
  const auto deadline = Clock::now() + std::chrono::duration<double>(timeout);
  char buffer[65536];
  for (;;) {
    const std::chrono::duration<double, std::milli> left = deadline - Clock::now();
    if (left.count() <= 0.0) return ReadEnd::kTimeout;
    pollfd wait{fd, POLLIN, 0};
    const int ready = ::poll(&wait, 1, static_cast<int>(std::min(left.count(), 1e6)) + 1);
    if (ready < 0 && errno != EINTR) return ReadEnd::kError;
    if (ready <= 0) continue;
    const ssize_t n = ::read(fd, buffer, sizeof buffer);
    if (n == 0) return ReadEnd::kComplete;
    if (n < 0 && errno != EINTR) return ReadEnd::kError;
    if (n > 0) text.append(buffer, static_cast<std::size_t>(n));
  }
}

// Without the XML prologue, which may not stand inside a page.
std::string svg_element(const std::string& text) {
  const std::size_t begin = text.find("<svg");
  const std::size_t end = text.rfind("</svg>");
  if (begin == std::string::npos || end == std::string::npos || end < begin) return {};
  return text.substr(begin, end + 6 - begin);
}

}  // namespace

PlotResult run_gnuplot(const std::string& script, const GnuplotOptions& options) {
  const UnnamedFile input = unnamed_file(script);
  const UnnamedFile errors = unnamed_file();
  int ends[2];
  if (!input || !errors || ::pipe2(ends, O_CLOEXEC) != 0) {
    return failure(PlotStatus::kGnuplotFailed,
                   "no temporary file for " + options.program + ": " + reason(errno));
  }
  pid_t child = 0;
  const int error =
      spawn(options.program, ::fileno(input.get()), ends[1], ::fileno(errors.get()), child);
  ::close(ends[1]);
  if (error != 0) {
    ::close(ends[0]);
    return failure(PlotStatus::kGnuplotMissing,
                   "\"" + options.program + "\" cannot be started: " + reason(error));
  }
  std::string text;
  const ReadEnd end = read_until_closed(ends[0], options.timeout, text);
  ::close(ends[0]);
  if (end != ReadEnd::kComplete) ::kill(child, SIGKILL);
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (end == ReadEnd::kTimeout) {
    return failure(PlotStatus::kGnuplotFailed, "\"" + options.program + "\" took longer than " +
                                                   std::to_string(options.timeout) + " s");
  }
  if (end == ReadEnd::kComplete && WIFEXITED(status) && WEXITSTATUS(status) == 127 &&
      text.empty()) {
    return failure(PlotStatus::kGnuplotMissing, "\"" + options.program + "\" cannot be started");
  }
  PlotResult result;
  result.svg = svg_element(text);
  if (!result.svg.empty()) return result;
  const std::string said = complaint(errors.get());
  return failure(PlotStatus::kGnuplotFailed,
                 "\"" + options.program + "\" gave no SVG" + (said.empty() ? "" : ": " + said));
}

}  // namespace dynslam::evaluation
