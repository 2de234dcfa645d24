// The seeds of the fuzz targets, in every build: each is a vocabulary or one clear error.
#include <filesystem>

#include <gtest/gtest.h>

#include "vocabulary_testing.hpp"

namespace dynslam::loop {
namespace {

TEST(FuzzCorpus, IsReadOrRefused) {
  const struct {
    const char* folder;
    VocabularyFormat format;
  } kTargets[] = {
      {"dynvoc", VocabularyFormat::kDynvoc}, {"text", VocabularyFormat::kText},
      {"yaml", VocabularyFormat::kYaml},     {"yaml_gz", VocabularyFormat::kYamlGz},
      {"dbow3", VocabularyFormat::kDbow3},   {"fbow", VocabularyFormat::kFbow},
  };
  std::size_t read = 0;
  for (const auto& target : kTargets) {
    const std::string folder = std::string(DYNSLAM_TEST_DATA_DIR) +
                               "/../../fuzz/corpus/vocabulary_" + target.folder + "_fuzz";
    for (const auto& file : std::filesystem::directory_iterator(folder)) {
      const auto bytes = testing::read_file(file.path().string());
      EXPECT_LT(bytes.size(), 8192U) << file.path();
      try {
        testing::load_bytes(target.format, bytes, testing::scratch(".yml.gz"));
        ++read;
      } catch (const IoError&) {
      }
    }
  }
  EXPECT_GE(read, 12U);
}

}  // namespace
}  // namespace dynslam::loop
