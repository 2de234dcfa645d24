// The seeds of a fuzz target, replayed by the room's own tests.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

namespace dynslam::testing {

/// Gives `parse` every seed of a target, at least `seeds`, which it has to read; and their
/// beginnings, each of which it may refuse by IoError.
template <typename Parse>
void replay_corpus(const std::string& target, std::size_t seeds, const Parse& parse) {
  const auto tests = std::filesystem::path(DYNSLAM_TEST_DATA_DIR).parent_path().parent_path();
  std::size_t read = 0;
  for (const auto& seed : std::filesystem::directory_iterator(tests / "fuzz/corpus" / target)) {
    const std::string bytes = read_file(seed.path().string());
    EXPECT_LT(bytes.size(), 4096U) << seed.path() << " is longer than tests/fuzz/run.sh makes them";
    EXPECT_NO_THROW(parse(bytes)) << seed.path();
    for (std::size_t size = 0; size < bytes.size(); size += 1 + bytes.size() / 500) {
      try {
        parse(std::string_view(bytes).substr(0, size));
      } catch (const IoError&) {
      }
    }
    ++read;
  }
  EXPECT_GE(read, seeds);
}

}  // namespace dynslam::testing
