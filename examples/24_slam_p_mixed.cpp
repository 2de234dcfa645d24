// P-Mixed: masks of a network with mixed attention, matches with improbable displacements rejected.
//
// The network is any segmentation::Segmenter, here one that the example brings itself
// (support/truth_segmenter.hpp: two functions). For the paper's own, train Mask R-CNN with the
// attention of `dynslam::attention`, make it fast with `dynslam fuse` and name it:
//
//   24_slam_p_mixed [FOLDER in TUM layout [SEGMENTER, for example mask-rcnn:mixed.onnx]]
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "support/demo.hpp"

using namespace dynslam;

int main(int argc, char** argv) {
  return examples::run_demo(argc, argv, [](examples::Demo& demo) {
    const segmentation::MaskPolicy policy;
    slam::SystemOptions options = slam::p_mixed().options;  // reject_matches = true
    options.tracking.orb.max_features = 1200;               // and anything else, as you like
    slam::System system(demo.sequence().camera(), options);

    segmentation::Segmenter& network = demo.segmenter();
    cv::Mat mask;
    demo.for_each_frame([&](const dataset::Frame& frame) {
      policy.mask(network.segment(frame.color, examples::info_of(frame)), network.class_names(),
                  mask);
      system.track(examples::input_of(frame, mask));
    });
    return demo.judge("p-mixed", system);
  });
}
