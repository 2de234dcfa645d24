#include "dynslam/segmentation/decoders/dense_mask.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {

cv::Mat paste_mask(ImageView<const float> probability, const Detection& detection,
                   const Letterbox& letterbox, const cv::Rect& box, float threshold) {
  require(!probability.empty(), "paste_mask", "probability", "an empty view", "rows and columns");
  require(!box.empty(), "paste_mask", "box", "an empty box", "at least one pixel");
  const double per_x = probability.width / static_cast<double>(detection.right - detection.left);
  const double per_y = probability.height / static_cast<double>(detection.bottom - detection.top);
  cv::Mat mask(box.size(), CV_8UC1);
  // Pixel centre -> network -> cell, clamped at the outer cells.
  const auto cell = [](double network, double edge, double per, int cells) {
    return std::clamp((network - edge) * per - 0.5, 0.0, static_cast<double>(cells - 1));
  };
  for (int y = 0; y < box.height; ++y) {
    const double network_y = (box.y + y + 0.5) * letterbox.scale_y + letterbox.inner.y;
    const double v = cell(network_y, static_cast<double>(detection.top), per_y, probability.height);
    const int v0 = static_cast<int>(v);
    const float* upper = probability.row(v0);
    const float* lower = probability.row(std::min(v0 + 1, probability.height - 1));
    const auto wv = static_cast<float>(v - v0);
    std::uint8_t* out = mask.ptr(y);
    for (int x = 0; x < box.width; ++x) {
      const double network_x = (box.x + x + 0.5) * letterbox.scale_x + letterbox.inner.x;
      const double u =
          cell(network_x, static_cast<double>(detection.left), per_x, probability.width);
      const int u0 = static_cast<int>(u);
      const int u1 = std::min(u0 + 1, probability.width - 1);
      const auto wu = static_cast<float>(u - u0);
      const float above = upper[u0] + (upper[u1] - upper[u0]) * wu;
      const float below = lower[u0] + (lower[u1] - lower[u0]) * wu;
      out[x] = above + (below - above) * wv > threshold ? 255 : 0;
    }
  }
  return mask;
}

std::vector<Instance> decode_semantic(TensorView<const float> scores, const Letterbox& letterbox,
                                      int background) {
  require(!scores.empty(), "decode_semantic", "scores", "an empty view",
          "classes, rows and columns");
  require(scores.channels <= 255, "decode_semantic", "scores.channels", scores.channels,
          "at most 255 classes");
  cv::Mat labels(scores.height, scores.width, CV_8UC1);
  std::vector<double> sum(static_cast<std::size_t>(scores.channels), 0.0);
  std::vector<int> count(sum.size(), 0);
  for (int y = 0; y < scores.height; ++y) {
    for (int x = 0; x < scores.width; ++x) {
      int best = 0;
      for (int c = 1; c < scores.channels; ++c) {
        if (scores(c, y, x) > scores(best, y, x)) best = c;
      }
      labels.at<std::uint8_t>(y, x) = static_cast<std::uint8_t>(best);
      if (best == background) continue;
      double total = 0.0;
      for (int c = 0; c < scores.channels; ++c) {
        total += std::exp(static_cast<double>(scores(c, y, x) - scores(best, y, x)));
      }
      sum[static_cast<std::size_t>(best)] += 1.0 / total;
      ++count[static_cast<std::size_t>(best)];
    }
  }
  // Nearest cell of every image pixel.
  cv::Mat image(letterbox.image, CV_8UC1);
  for (int y = 0; y < image.rows; ++y) {
    const double v = ((y + 0.5) * letterbox.scale_y + letterbox.inner.y) * scores.height /
                     letterbox.network.height;
    const std::uint8_t* row = labels.ptr(std::clamp(static_cast<int>(v), 0, scores.height - 1));
    std::uint8_t* out = image.ptr(y);
    for (int x = 0; x < image.cols; ++x) {
      const double u = ((x + 0.5) * letterbox.scale_x + letterbox.inner.x) * scores.width /
                       letterbox.network.width;
      out[x] = row[std::clamp(static_cast<int>(u), 0, scores.width - 1)];
    }
  }
  std::vector<Instance> instances;
  for (int c = 0; c < scores.channels; ++c) {
    const auto id = static_cast<std::size_t>(c);
    if (c == background || count[id] == 0) continue;
    const cv::Mat mask = image == c;
    Instance instance;
    instance.box = cv::boundingRect(mask);
    if (instance.box.empty()) continue;
    instance.class_id = c;
    instance.score = static_cast<float>(sum[id] / count[id]);
    instance.mask = mask(instance.box).clone();
    instances.push_back(std::move(instance));
  }
  return instances;
}

}  // namespace dynslam::segmentation
