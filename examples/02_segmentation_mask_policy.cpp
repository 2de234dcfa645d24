// From what a network found to the mask that keeps features off people: which classes may move,
// how sure the network must be, how far the mask reaches.
#include <cstdio>

#include <opencv2/core.hpp>

#include "dynslam/core/opencv.hpp"
#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

namespace seg = dynslam::segmentation;

namespace {

seg::Instance instance_of(int class_id, float score, cv::Rect box) {
  seg::Instance instance;
  instance.class_id = class_id;
  instance.score = score;
  instance.box = box;
  instance.mask = cv::Mat(box.size(), CV_8UC1, cv::Scalar(255));
  return instance;
}

void report(const char* title, const seg::MaskPolicy& policy, const seg::Segmentation& found) {
  const cv::Mat mask = policy.mask(found, seg::coco_class_names());
  const dynslam::MaskView view = dynslam::as_view<const std::uint8_t>(mask);
  int dynamic = 0;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) dynamic += view(x, y) == 255 ? 1 : 0;
  }
  std::printf("%-42s %6.2f %% of the pixels move\n", title,
              100.0 * dynamic / (view.width * view.height));
}

}  // namespace

int main() {
  // In a real program: auto segmenter = make_segmenter("yolo-seg:yolov5n-seg.onnx"), and for every
  // frame: found = segmenter->segment(image, {}).
  seg::Segmentation found;
  found.width = 640;
  found.height = 480;
  found.instances = {instance_of(0, 0.9F, {100, 80, 120, 360}),     // person
                     instance_of(0, 0.35F, {500, 200, 40, 120}),    // somebody far away
                     instance_of(56, 0.8F, {300, 250, 100, 150})};  // chair

  seg::MaskPolicyOptions options;
  report("default: people, vehicles, animals", seg::MaskPolicy(options), found);
  options.min_score = 0.5F;
  report("only from score 0.5", seg::MaskPolicy(options), found);
  options.dilation_px = 0;
  report("... without dilation", seg::MaskPolicy(options), found);
  options.classes = {"person", "chair"};
  report("... and chairs as well", seg::MaskPolicy(options), found);
  return 0;
}
