#include "fuzz/corpus.hpp"
#include "fuzz/network_files.hpp"

namespace dynslam::segmentation {
namespace {

TEST(FuzzCorpus, IsReadAndItsBeginningsAreReadOrRefused) {
  dynslam::testing::replay_corpus("network_files_fuzz", 5, testing::parse_any);
}

}  // namespace
}  // namespace dynslam::segmentation
