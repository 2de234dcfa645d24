// SLAM as for a world that stands still: no masks, no geometry, no weights. What walks through the
// picture takes the camera with it; the other compositions (22, 23, 24) are measured against this.
//
//   21_slam_baseline [FOLDER in TUM layout]
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "support/demo.hpp"

using namespace dynslam;

int main(int argc, char** argv) {
  return examples::run_demo(argc, argv, [](examples::Demo& demo) {
    slam::System system(demo.sequence().camera(), slam::baseline().options);
    demo.for_each_frame([&](const dataset::Frame& frame) {  //
      system.track(examples::input_of(frame));
    });
    return demo.judge("baseline", system);
  });
}
