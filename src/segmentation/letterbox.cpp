#include "dynslam/segmentation/letterbox.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {
namespace {

std::string size_text(cv::Size size) {
  return std::to_string(size.width) + "x" + std::to_string(size.height);
}

}  // namespace

cv::Rect Letterbox::to_image(const Detection& box) const {
  const auto edge = [](double at, int offset, double scale, int limit) {
    return std::clamp((at - offset) / scale, 0.0, static_cast<double>(limit));
  };
  const int left = static_cast<int>(std::floor(edge(box.left, inner.x, scale_x, image.width)));
  const int top = static_cast<int>(std::floor(edge(box.top, inner.y, scale_y, image.height)));
  const int right = static_cast<int>(std::ceil(edge(box.right, inner.x, scale_x, image.width)));
  const int bottom = static_cast<int>(std::ceil(edge(box.bottom, inner.y, scale_y, image.height)));
  if (right <= left || bottom <= top) return {};
  return {left, top, right - left, bottom - top};
}

Letterbox make_letterbox(cv::Size image, cv::Size network, LetterboxPlace place) {
  require(image.width > 0 && image.height > 0, "make_letterbox", "image", size_text(image),
          "a size above zero");
  require(network.width > 0 && network.height > 0, "make_letterbox", "network", size_text(network),
          "a size above zero");
  Letterbox box;
  box.image = image;
  box.network = network;
  if (place == LetterboxPlace::kStretch) {
    box.inner = cv::Rect(0, 0, network.width, network.height);
  } else {
    const double scale = std::min(static_cast<double>(network.width) / image.width,
                                  static_cast<double>(network.height) / image.height);
    box.inner.width =
        std::clamp(static_cast<int>(std::lround(image.width * scale)), 1, network.width);
    box.inner.height =
        std::clamp(static_cast<int>(std::lround(image.height * scale)), 1, network.height);
    if (place == LetterboxPlace::kCentre) {
      box.inner.x = (network.width - box.inner.width) / 2;
      box.inner.y = (network.height - box.inner.height) / 2;
    }
  }
  box.scale_x = static_cast<double>(box.inner.width) / image.width;
  box.scale_y = static_cast<double>(box.inner.height) / image.height;
  return box;
}

void fill_input(const cv::Mat& image, const Letterbox& letterbox, const PixelScale& pixels,
                std::vector<float>& blob, std::vector<cv::Mat>& scratch) {
  require(image.size() == letterbox.image, "fill_input", "image", size_text(image.size()),
          "the letterbox's size " + size_text(letterbox.image));
  require(image.type() == CV_8UC1 || image.type() == CV_8UC3 || image.type() == CV_8UC4,
          "fill_input", "image", cv::typeToString(image.type()), "CV_8UC1, CV_8UC3 or CV_8UC4");
  const cv::Size network = letterbox.network;
  const cv::Rect inner = letterbox.inner;
  const std::size_t plane = static_cast<std::size_t>(network.area());
  blob.resize(3 * plane);
  scratch.resize(5);
  cv::Mat scaled = image;
  if (inner.size() != image.size()) {
    cv::resize(image, scratch[4], inner.size(), 0, 0, cv::INTER_LINEAR);
    scaled = scratch[4];
  }
  const int channels = scaled.channels();
  cv::Mat planes[4] = {scratch[0], scratch[1], scratch[2], scratch[3]};
  if (channels == 1) {
    planes[0] = scaled;
  } else {
    cv::split(scaled, planes);
    for (int c = 0; c < channels; ++c) scratch[static_cast<std::size_t>(c)] = planes[c];
  }
  for (int c = 0; c < 3; ++c) {
    cv::Mat target(network, CV_32FC1, blob.data() + static_cast<std::size_t>(c) * plane);
    const double factor = pixels.factor[c];
    const double shift = -pixels.mean[c] * factor;
    if (inner.size() != network) target.setTo(pixels.border * factor + shift);
    const cv::Mat& source = planes[channels == 1 ? 0 : (pixels.rgb ? 2 - c : c)];
    cv::Mat window = target(inner);
    source.convertTo(window, CV_32F, factor, shift);
  }
}

}  // namespace dynslam::segmentation
