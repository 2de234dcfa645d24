#include "fuzz/corpus.hpp"
#include "fuzz/dataset_files.hpp"

namespace dynslam::dataset {
namespace {

TEST(FuzzCorpus, IsReadAndItsBeginningsAreReadOrRefused) {
  dynslam::testing::replay_corpus("dataset_files_fuzz", 12, testing::parse_any);
}

}  // namespace
}  // namespace dynslam::dataset
