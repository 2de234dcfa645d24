// Writes tests/fuzz/corpus/map_fuzz: the seeds of the fuzzer, and the files that every later
// version must still read. From the project's folder, linked with slam and core:
//
//   make_map_seeds tests/fuzz/corpus/map_fuzz
#include "dynslam/slam/map_io.hpp"

#include "slam/small_map.hpp"

int main(int argc, char** argv) {
  using namespace dynslam::slam;
  if (argc != 2) return 1;
  const std::string folder = argv[1];
  save_map(folder + "/small", testing::small_map(), testing::small_camera(),
           testing::small_scales());
  save_map(folder + "/empty", Map(), testing::small_camera(), testing::small_scales());
}
