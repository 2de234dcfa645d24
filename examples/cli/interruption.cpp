#include "interruption.hpp"

#include <csignal>

#include <signal.h>

namespace dynslam::cli {
namespace {

volatile std::sig_atomic_t was_interrupted = 0;

void note_interruption(int) { was_interrupted = 1; }

}  // namespace

void catch_interruption() {
  struct sigaction before {};
  ::sigaction(SIGINT, nullptr, &before);
  if (before.sa_handler == SIG_IGN) return;
  struct sigaction once {};
  once.sa_handler = note_interruption;
  once.sa_flags = static_cast<int>(SA_RESETHAND | SA_RESTART);
  ::sigaction(SIGINT, &once, nullptr);
}

bool interrupted() { return was_interrupted != 0; }

}  // namespace dynslam::cli
