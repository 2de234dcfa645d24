// P-Yolo: a network says what may move, and the features on it are dropped before tracking.
// Whatever moves and is of no known class (the box that one of the people carries, for a network
// that knows people only) is not seen; P-Static (23) is for that.
//
//   22_slam_p_yolo [FOLDER in TUM layout [SEGMENTER, for example yolo-seg:yolov5n-seg.onnx]]
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/slam/compositions.hpp"
#include "dynslam/slam/system.hpp"

#include "support/demo.hpp"

using namespace dynslam;

int main(int argc, char** argv) {
  return examples::run_demo(argc, argv, [](examples::Demo& demo) {
    segmentation::MaskPolicyOptions which;  // people, vehicles and animals by default
    which.dilation_px = 10;                 // a feature's patch reaches beyond its corner
    const segmentation::MaskPolicy policy(which);

    slam::System system(demo.sequence().camera(), slam::p_yolo().options);
    demo.for_each_frame([&](const dataset::Frame& frame) {
      const auto found = demo.segmenter().segment(frame.color, examples::info_of(frame));
      const cv::Mat mask = policy.mask(found, demo.segmenter().class_names());
      system.track(examples::input_of(frame, mask));  // no feature lies on the mask
    });
    return demo.judge("p-yolo", system);
  });
}
