// P-Static: masks for what a network knows, the weighted geometric constraint for what it does not,
// and a static weight for every point in the pose. Shown twice, the second time without the
// network: geometry then has to find the walkers alone.
//
//   23_slam_p_static [FOLDER in TUM layout [SEGMENTER]]
#include <algorithm>
#include <cstdio>

#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "support/demo.hpp"

using namespace dynslam;

namespace {

int track(examples::Demo& demo, const slam::Composition& composition, const char* name) {
  const segmentation::MaskPolicy policy;
  slam::System system(demo.sequence().camera(), composition.options);
  int most_moving = 0;
  demo.for_each_frame([&](const dataset::Frame& frame) {
    cv::Mat mask;
    if (composition.masks) {
      const auto found = demo.segmenter().segment(frame.color, examples::info_of(frame));
      policy.mask(found, demo.segmenter().class_names(), mask);
    }
    const slam::FrameResult result = system.track(examples::input_of(frame, mask));
    most_moving = std::max(most_moving, result.moving_features);
  });
  std::printf("geometry let go of up to %d features of a frame\n", most_moving);
  return demo.judge(name, system);
}

}  // namespace

int main(int argc, char** argv) {
  return examples::run_demo(argc, argv, [](examples::Demo& demo) {
    // Its options: geometry = true, weights = factors::WeightMode::kEliminated.
    const slam::Composition p_static = slam::p_static();
    const int with_masks = track(demo, p_static, "p-static");
    const int alone = track(demo, p_static.without(slam::Part::kMask), "p-static without mask");
    return std::max(with_masks, alone);
  });
}
