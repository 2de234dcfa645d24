#include "dynslam/segmentation/decoders/prototype_mask.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "dynslam/core/errors.hpp"

namespace dynslam::segmentation {
namespace {

// Where the pixel centres of one direction fall among prototype cells: pixel i lies between the
// cells left and left + 1 (both clamped), `weight` of the way.
struct Axis {
  double scale = 1.0;
  double offset = 0.0;
  int cells = 0;

  double at(int pixel) const {
    return std::clamp((pixel + 0.5) * scale + offset, 0.0, static_cast<double>(cells - 1));
  }
};

// Image edge x -> network edge x * scale + inner -> cell edge (times cells / network), and cell
// centres lie half a cell inside.
Axis make_axis(double scale, int inner, int network, int cells) {
  const double per_cell = static_cast<double>(cells) / network;
  return {scale * per_cell, inner * per_cell - 0.5, cells};
}

// out[i] = sum over channels of coefficients[c] * prototypes(c, y, x0 + i).
void sum_row(TensorView<const float> prototypes, Span<const float> coefficients, int y, int x0,
             int count, float* out) {
  std::fill(out, out + count, 0.0F);
  const std::size_t at = static_cast<std::size_t>(y) * static_cast<std::size_t>(prototypes.width) +
                         static_cast<std::size_t>(x0);
  std::size_t c = 0;
  for (; c + 4 <= coefficients.size(); c += 4) {
    const float* p0 = prototypes.plane(static_cast<int>(c)) + at;
    const float* p1 = prototypes.plane(static_cast<int>(c) + 1) + at;
    const float* p2 = prototypes.plane(static_cast<int>(c) + 2) + at;
    const float* p3 = prototypes.plane(static_cast<int>(c) + 3) + at;
    const float k0 = coefficients[c], k1 = coefficients[c + 1];
    const float k2 = coefficients[c + 2], k3 = coefficients[c + 3];
    for (int i = 0; i < count; ++i) {
      out[i] += (k0 * p0[i] + k1 * p1[i]) + (k2 * p2[i] + k3 * p3[i]);
    }
  }
  for (; c < coefficients.size(); ++c) {
    const float* p = prototypes.plane(static_cast<int>(c)) + at;
    for (int i = 0; i < count; ++i) out[i] += coefficients[c] * p[i];
  }
}

// One row of pixels from one row of cell values: runs between two cells of one sign need no
// interpolation.
void threshold_row(const float* cells, const int* left, const float* weight, int width, int last,
                   std::uint8_t* out) {
  for (int x = 0; x < width;) {
    const int cell = left[x];
    int end = x + 1;
    while (end < width && left[end] == cell) ++end;
    const float a = cells[cell];
    const float b = cells[std::min(cell + 1, last)];
    const bool positive = a > 0.0F;
    if (positive == (b > 0.0F)) {
      std::memset(out + x, positive ? 255 : 0, static_cast<std::size_t>(end - x));
    } else {
      for (int i = x; i < end; ++i) out[i] = a + (b - a) * weight[i] > 0.0F ? 255 : 0;
    }
    x = end;
  }
}

}  // namespace

cv::Mat prototype_mask(TensorView<const float> prototypes, Span<const float> coefficients,
                       const Letterbox& letterbox, const cv::Rect& box, PrototypeScratch& scratch) {
  require(!prototypes.empty(), "prototype_mask", "prototypes", "an empty view",
          "channels, rows and columns");
  require(coefficients.size() == static_cast<std::size_t>(prototypes.channels), "prototype_mask",
          "coefficients", coefficients.size(), std::to_string(prototypes.channels) + " of them");
  const cv::Rect inside = box & cv::Rect(cv::Point(), letterbox.image);
  require(!box.empty() && inside == box, "prototype_mask", "box",
          std::to_string(box.width) + "x" + std::to_string(box.height) + " at " +
              std::to_string(box.x) + ", " + std::to_string(box.y),
          "a box inside the image");
  const Axis across =
      make_axis(letterbox.scale_x, letterbox.inner.x, letterbox.network.width, prototypes.width);
  const Axis down =
      make_axis(letterbox.scale_y, letterbox.inner.y, letterbox.network.height, prototypes.height);
  const int x0 = static_cast<int>(across.at(box.x));
  const int x1 = std::min(static_cast<int>(across.at(box.br().x - 1)) + 1, prototypes.width - 1);
  const int y0 = static_cast<int>(down.at(box.y));
  const int y1 = std::min(static_cast<int>(down.at(box.br().y - 1)) + 1, prototypes.height - 1);
  const int columns = x1 - x0 + 1;

  scratch.logits.resize(static_cast<std::size_t>(columns) * static_cast<std::size_t>(y1 - y0 + 1));
  for (int y = y0; y <= y1; ++y) {
    sum_row(prototypes, coefficients, y, x0, columns,
            scratch.logits.data() + static_cast<std::ptrdiff_t>(y - y0) * columns);
  }
  scratch.row.resize(static_cast<std::size_t>(columns));
  scratch.left.resize(static_cast<std::size_t>(box.width));
  scratch.weight.resize(static_cast<std::size_t>(box.width));
  for (int x = 0; x < box.width; ++x) {
    const double at = across.at(box.x + x);
    scratch.left[static_cast<std::size_t>(x)] = static_cast<int>(at) - x0;
    scratch.weight[static_cast<std::size_t>(x)] = static_cast<float>(at - static_cast<int>(at));
  }
  cv::Mat mask(box.size(), CV_8UC1);
  for (int y = 0; y < box.height; ++y) {
    const double at = down.at(box.y + y);
    const int upper = static_cast<int>(at) - y0;
    const int lower = std::min(upper + 1, y1 - y0);
    const float weight = static_cast<float>(at - static_cast<int>(at));
    const float* a = scratch.logits.data() + static_cast<std::ptrdiff_t>(upper) * columns;
    const float* b = scratch.logits.data() + static_cast<std::ptrdiff_t>(lower) * columns;
    for (int x = 0; x < columns; ++x) {
      scratch.row[static_cast<std::size_t>(x)] = a[x] + (b[x] - a[x]) * weight;
    }
    threshold_row(scratch.row.data(), scratch.left.data(), scratch.weight.data(), box.width,
                  columns - 1, mask.ptr<std::uint8_t>(y));
  }
  return mask;
}

}  // namespace dynslam::segmentation
