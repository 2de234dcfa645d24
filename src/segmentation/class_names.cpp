#include <algorithm>
#include <array>
#include <cctype>
#include <utility>

#include "dynslam/segmentation/mask_policy.hpp"
#include "dynslam/segmentation/network_segmenters.hpp"
#include "dynslam/segmentation/yolo_seg_segmenter.hpp"

namespace dynslam::segmentation {

const std::vector<std::string>& coco_class_names() {
  static const std::vector<std::string> names = {"person",        "bicycle",      "car",
                                                 "motorcycle",    "airplane",     "bus",
                                                 "train",         "truck",        "boat",
                                                 "traffic light", "fire hydrant", "stop sign",
                                                 "parking meter", "bench",        "bird",
                                                 "cat",           "dog",          "horse",
                                                 "sheep",         "cow",          "elephant",
                                                 "bear",          "zebra",        "giraffe",
                                                 "backpack",      "umbrella",     "handbag",
                                                 "tie",           "suitcase",     "frisbee",
                                                 "skis",          "snowboard",    "sports ball",
                                                 "kite",          "baseball bat", "baseball glove",
                                                 "skateboard",    "surfboard",    "tennis racket",
                                                 "bottle",        "wine glass",   "cup",
                                                 "fork",          "knife",        "spoon",
                                                 "bowl",          "banana",       "apple",
                                                 "sandwich",      "orange",       "broccoli",
                                                 "carrot",        "hot dog",      "pizza",
                                                 "donut",         "cake",         "chair",
                                                 "couch",         "potted plant", "bed",
                                                 "dining table",  "toilet",       "tv",
                                                 "laptop",        "mouse",        "remote",
                                                 "keyboard",      "cell phone",   "microwave",
                                                 "oven",          "toaster",      "sink",
                                                 "refrigerator",  "book",         "clock",
                                                 "vase",          "scissors",     "teddy bear",
                                                 "hair drier",    "toothbrush"};
  return names;
}

const std::vector<std::string>& coco91_class_names() {
  static const std::vector<std::string> names = [] {
    // The numbers that COCO's list of 91 does not use.
    constexpr std::array<int, 10> kUnused = {12, 26, 29, 30, 45, 66, 68, 69, 71, 83};
    std::vector<std::string> all = {"background"};
    auto next = coco_class_names().begin();
    for (int id = 1; id <= 90; ++id) {
      const bool unused = std::find(kUnused.begin(), kUnused.end(), id) != kUnused.end();
      all.push_back(unused ? "n/a" : *next++);
    }
    return all;
  }();
  return names;
}

const std::vector<std::string>& voc_class_names() {
  static const std::vector<std::string> names = {
      "background", "airplane", "bicycle",      "bird",  "boat",         "bottle", "bus",
      "car",        "cat",      "chair",        "cow",   "dining table", "dog",    "horse",
      "motorcycle", "person",   "potted plant", "sheep", "couch",        "train",  "tv"};
  return names;
}

const std::vector<std::string>& default_dynamic_classes() {
  static const std::vector<std::string> names = {
      "person", "bicycle", "car",   "motorcycle", "bus",      "train", "truck", "bird",    "cat",
      "dog",    "horse",   "sheep", "cow",        "elephant", "bear",  "zebra", "giraffe", "mover"};
  return names;
}

std::string canonical_class_name(const std::string& name) {
  std::string plain;
  for (const char c : name) {
    const auto byte = static_cast<unsigned char>(c);
    const bool gap = c == '-' || c == '_' || std::isspace(byte) != 0;
    if (gap && (plain.empty() || plain.back() == ' ')) continue;
    plain += gap ? ' ' : static_cast<char>(std::tolower(byte));
  }
  if (!plain.empty() && plain.back() == ' ') plain.pop_back();
  // Darknet's and VOC's spellings on the left.
  static constexpr std::array<std::pair<const char*, const char*>, 8> kSpellings = {{
      {"motorbike", "motorcycle"},
      {"aeroplane", "airplane"},
      {"sofa", "couch"},
      {"pottedplant", "potted plant"},
      {"diningtable", "dining table"},
      {"tvmonitor", "tv"},
      {"television", "tv"},
      {"hair dryer", "hair drier"},
  }};
  for (const auto& [from, to] : kSpellings) {
    if (plain == from) return to;
  }
  return plain;
}

}  // namespace dynslam::segmentation
