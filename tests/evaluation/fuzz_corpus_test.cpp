#include "fuzz/corpus.hpp"
#include "fuzz/trajectory.hpp"

namespace dynslam::evaluation {
namespace {

TEST(FuzzCorpus, IsReadAndItsBeginningsAreReadOrRefused) {
  dynslam::testing::replay_corpus("trajectory_fuzz", 2, testing::parse_any);
}

}  // namespace
}  // namespace dynslam::evaluation
