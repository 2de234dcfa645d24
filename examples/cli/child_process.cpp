#include "child_process.hpp"

#include <array>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "dynslam/core/errors.hpp"

extern char** environ;

namespace dynslam::cli {
namespace {

// Where the child's output goes, and what else it inherits.
class SpawnActions {
 public:
  explicit SpawnActions(const std::array<int, 2>& pipe) {
    posix_spawn_file_actions_init(&actions_);
    posix_spawn_file_actions_adddup2(&actions_, pipe[1], STDOUT_FILENO);
    posix_spawn_file_actions_addclose(&actions_, pipe[0]);
    posix_spawn_file_actions_addclose(&actions_, pipe[1]);
    posix_spawn_file_actions_addopen(&actions_, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
  }
  ~SpawnActions() { posix_spawn_file_actions_destroy(&actions_); }
  SpawnActions(const SpawnActions&) = delete;
  SpawnActions& operator=(const SpawnActions&) = delete;
  const posix_spawn_file_actions_t* get() const { return &actions_; }

 private:
  posix_spawn_file_actions_t actions_{};
};

std::string read_to_end(int descriptor) {
  std::string text;
  std::array<char, 65536> buffer{};
  while (true) {
    const ssize_t count = read(descriptor, buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) return text;
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
}

}  // namespace

std::string output_of(const std::vector<std::string>& command) {
  std::vector<char*> arguments;
  for (const std::string& argument : command) {
    arguments.push_back(const_cast<char*>(argument.c_str()));
  }
  arguments.push_back(nullptr);
  std::array<int, 2> ends{};
  if (pipe(ends.data()) != 0) throw_io_error(command[0], std::strerror(errno));
  pid_t child = 0;
  const int error = posix_spawnp(&child, arguments[0], SpawnActions(ends).get(), nullptr,
                                 arguments.data(), environ);
  close(ends[1]);
  const std::string text = error == 0 ? read_to_end(ends[0]) : std::string();
  close(ends[0]);
  if (error != 0)
    throw_io_error(command[0], std::string("cannot be started: ") + std::strerror(error));
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    throw_io_error(command[0], WIFSIGNALED(status)
                                   ? "was ended by signal " + std::to_string(WTERMSIG(status))
                                   : "ended with code " + std::to_string(WEXITSTATUS(status)));
  }
  return text;
}

}  // namespace dynslam::cli
