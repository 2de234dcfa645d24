#include "fuzz/attention_files.hpp"
#include "fuzz/corpus.hpp"

namespace dynslam::attention {
namespace {

TEST(FuzzCorpus, IsReadAndItsBeginningsAreReadOrRefused) {
  dynslam::testing::replay_corpus("attention_files_fuzz", 5, testing::parse_any);
}

}  // namespace
}  // namespace dynslam::attention
