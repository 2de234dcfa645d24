// What the benchmark programs call their cases: which name is whose time of what.
#pragma once

#include <string>

namespace dynslam::cli {

/// A benchmark's name taken apart.
struct BenchName {
  std::string what;  ///< the case, the same for all that are compared
  std::string
      target;  ///< ours: an instruction set or a variant, "best" for what is chosen by itself
  std::string rival;  ///< the other's name, "floor" for what cannot be beaten; empty: it is ours
};

/// Takes the name of a benchmark of a room apart; a name of no known form is a case of its own, and
/// ours. Suffixes that say how time was taken (/real_time, /min_time:...) are dropped.
BenchName bench_name(const std::string& room, const std::string& name);

}  // namespace dynslam::cli
