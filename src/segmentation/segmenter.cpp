#include "dynslam/segmentation/segmenter.hpp"

#include <algorithm>
#include <array>
#include <cctype>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

void require_segmentable(const char* function, const cv::Mat& image, const FrameInfo& frame) {
  require(!image.empty(), function, "image", "an empty image", "at least one pixel");
  const int type = image.type();
  require(image.dims == 2 && (type == CV_8UC1 || type == CV_8UC3 || type == CV_8UC4), function,
          "image", cv::typeToString(type), "CV_8UC1, CV_8UC3 or CV_8UC4 in two dimensions");
  const DepthView& depth = frame.depth;
  require(depth.empty() || (depth.width == image.cols && depth.height == image.rows), function,
          "frame.depth", std::to_string(depth.width) + "x" + std::to_string(depth.height),
          "no depth or the image's size " + std::to_string(image.cols) + "x" +
              std::to_string(image.rows));
}

void require_depth_image(const char* function, const cv::Mat& depth) {
  require(depth.empty() || (depth.dims == 2 && depth.type() == CV_32FC1), function, "depth",
          cv::typeToString(depth.type()), "CV_32FC1 in two dimensions, or no depth");
}

void require_sound(const char* function, const Segmentation& segmentation, cv::Size image) {
  const auto size_of = [](int width, int height) {
    return std::to_string(width) + "x" + std::to_string(height);
  };
  require(segmentation.width == image.width && segmentation.height == image.height, function,
          "segmentation", size_of(segmentation.width, segmentation.height),
          "the image's size " + size_of(image.width, image.height));
  for (const Instance& instance : segmentation.instances) {
    const cv::Rect& box = instance.box;
    // Not box.br(), which may overflow.
    const bool inside = box.x >= 0 && box.y >= 0 && box.width > 0 && box.height > 0 &&
                        box.width <= image.width - box.x && box.height <= image.height - box.y;
    require(inside, function, "box",
            size_of(box.width, box.height) + " at " + std::to_string(box.x) + ", " +
                std::to_string(box.y),
            "a box inside the image");
    const cv::Mat& mask = instance.mask;
    require(mask.dims == 2 && mask.type() == CV_8UC1 && mask.size() == box.size(), function, "mask",
            size_of(mask.cols, mask.rows) + " of " + cv::typeToString(mask.type()),
            "CV_8UC1 of the box's size " + size_of(box.width, box.height));
  }
}

std::string frame_stem(const std::string& name) {
  const std::size_t slash = name.find_last_of("/\\");
  std::string stem = slash == std::string::npos ? name : name.substr(slash + 1);
  const std::size_t dot = stem.rfind('.');
  if (dot == std::string::npos) return stem;
  std::string extension = stem.substr(dot + 1);
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  constexpr std::array<const char*, 8> kImages = {"png", "jpg", "jpeg", "bmp",
                                                  "pgm", "ppm", "tif",  "tiff"};
  const bool is_image = std::any_of(kImages.begin(), kImages.end(),
                                    [&](const char* image) { return extension == image; });
  if (is_image) stem.resize(dot);
  return stem;
}

}  // namespace dynslam::segmentation
