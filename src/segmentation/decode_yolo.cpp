#include <algorithm>
#include <cmath>

#include "dynslam/core/errors.hpp"
#include "dynslam/segmentation/decoders/yolo.hpp"

namespace dynslam::segmentation {
namespace {

// False if the numbers are not a box: then nothing is appended.
bool append_box(float cx, float cy, float w, float h, float score, int class_id, int index,
                std::vector<Detection>& out) {
  Detection d;
  d.class_id = class_id;
  d.score = score;
  d.left = cx - 0.5F * w;
  d.top = cy - 0.5F * h;
  d.right = cx + 0.5F * w;
  d.bottom = cy + 0.5F * h;
  d.index = index;
  const bool finite = std::isfinite(d.left) && std::isfinite(d.top) && std::isfinite(d.right) &&
                      std::isfinite(d.bottom);
  if (!finite || !(d.right > d.left) || !(d.bottom > d.top)) return false;
  out.push_back(d);
  return true;
}

}  // namespace

void decode_yolov5(MatrixView rows, int classes, float score_threshold,
                   std::vector<Detection>& out) {
  require(classes >= 1, "decode_yolov5", "classes", classes, "at least 1");
  require(rows.empty() || rows.width >= 5 + classes, "decode_yolov5", "rows.width", rows.width,
          "at least 5 + classes = " + std::to_string(5 + classes));
  for (int i = 0; i < rows.height; ++i) {
    const float* row = rows.row(i);
    const float objectness = row[4];
    // No class probability is above 1, so most candidates end here.
    if (!(objectness >= score_threshold)) continue;
    const float* first = row + 5;
    const float* best = std::max_element(first, first + classes);
    const float score = objectness * *best;
    if (!(score >= score_threshold)) continue;
    append_box(row[0], row[1], row[2], row[3], score, static_cast<int>(best - first), i, out);
  }
}

void decode_yolov8(MatrixView columns, int classes, float score_threshold,
                   std::vector<Detection>& out) {
  require(classes >= 1, "decode_yolov8", "classes", classes, "at least 1");
  require(columns.empty() || columns.height >= 4 + classes, "decode_yolov8", "columns.height",
          columns.height, "at least 4 + classes = " + std::to_string(4 + classes));
  if (columns.empty()) return;
  // The best class of a block of columns at a time: rows are contiguous, and the block stays in
  // the nearest cache.
  constexpr int kBlock = 256;
  float best[kBlock];
  for (int begin = 0; begin < columns.width; begin += kBlock) {
    const int count = std::min(kBlock, columns.width - begin);
    std::fill(best, best + count, -1.0F);
    for (int c = 0; c < classes; ++c) {
      const float* row = columns.row(4 + c) + begin;
      for (int i = 0; i < count; ++i) best[i] = row[i] > best[i] ? row[i] : best[i];
    }
    for (int i = 0; i < count; ++i) {
      if (!(best[i] >= score_threshold)) continue;
      const int at = begin + i;
      int class_id = 0;
      while (class_id + 1 < classes && columns(at, 4 + class_id) != best[i]) ++class_id;
      append_box(columns(at, 0), columns(at, 1), columns(at, 2), columns(at, 3), best[i], class_id,
                 at, out);
    }
  }
}

void decode_yolox(MatrixView rows, int classes, int input_width, int input_height,
                  float score_threshold, std::vector<Detection>& out) {
  require(classes >= 1, "decode_yolox", "classes", classes, "at least 1");
  require(rows.empty() || rows.width >= 5 + classes, "decode_yolox", "rows.width", rows.width,
          "at least 5 + classes = " + std::to_string(5 + classes));
  int cells = 0;
  for (const int stride : {8, 16, 32}) cells += (input_width / stride) * (input_height / stride);
  require(rows.height == cells, "decode_yolox", "rows.height", rows.height,
          "the grid cells of strides 8, 16 and 32: " + std::to_string(cells));
  int i = 0;
  for (const int stride : {8, 16, 32}) {
    const auto scale = static_cast<float>(stride);
    for (int y = 0; y < input_height / stride; ++y) {
      for (int x = 0; x < input_width / stride; ++x, ++i) {
        const float* row = rows.row(i);
        if (!(row[4] >= score_threshold)) continue;
        const float* best = std::max_element(row + 5, row + 5 + classes);
        const float score = row[4] * *best;
        if (!(score >= score_threshold)) continue;
        append_box((row[0] + static_cast<float>(x)) * scale,
                   (row[1] + static_cast<float>(y)) * scale, std::exp(row[2]) * scale,
                   std::exp(row[3]) * scale, score, static_cast<int>(best - row - 5), i, out);
      }
    }
  }
}

void decode_darknet(MatrixView rows, int classes, int input_width, int input_height,
                    float score_threshold, std::vector<Detection>& out) {
  require(classes >= 1, "decode_darknet", "classes", classes, "at least 1");
  require(rows.empty() || rows.width >= 5 + classes, "decode_darknet", "rows.width", rows.width,
          "at least 5 + classes = " + std::to_string(5 + classes));
  const auto width = static_cast<float>(input_width);
  const auto height = static_cast<float>(input_height);
  for (int i = 0; i < rows.height; ++i) {
    const float* row = rows.row(i);
    const float* best = std::max_element(row + 5, row + 5 + classes);
    if (!(*best >= score_threshold)) continue;
    append_box(row[0] * width, row[1] * height, row[2] * width, row[3] * height, *best,
               static_cast<int>(best - row - 5), i, out);
  }
}

}  // namespace dynslam::segmentation
