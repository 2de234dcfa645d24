// Another program, run to its end.
#pragma once

#include <string>
#include <vector>

namespace dynslam::cli {

/// Runs a program without a shell and returns what it wrote to its standard output; what it writes
/// to stderr is dropped. Throws IoError naming the program when it cannot be started or does not
/// end with 0.
std::string output_of(const std::vector<std::string>& command);

}  // namespace dynslam::cli
