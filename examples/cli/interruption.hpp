// Ctrl-C ends a run early, but keeps what it has.
#pragma once

namespace dynslam::cli {

/// From here on the first SIGINT only makes `interrupted` true, and the second ends the program.
/// Where the signal is ignored (nohup, a shell's background job) it stays so.
void catch_interruption();

/// Whether the user wants the run to end.
bool interrupted();

}  // namespace dynslam::cli
