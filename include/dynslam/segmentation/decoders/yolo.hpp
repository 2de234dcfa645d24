// Decoders of the YOLO family: numbers of a network in, boxes out. They know nothing of backends.
//
// Matrices of network output are ImageViews of float. A candidate that is not finite, or whose box
// has no area, is not a detection: it is passed over.
#pragma once

#include <vector>

#include "dynslam/core/image_view.hpp"
#include "dynslam/segmentation/decoders/detection.hpp"

namespace dynslam::segmentation {

/// A network's output matrix, by rows.
using MatrixView = ImageView<const float>;

/// YOLOv5 and YOLOv7 (boxes or segmentation), decoded export: a row a candidate, cx, cy, w, h
/// (network pixels), objectness, `classes` class probabilities, then anything. Score = objectness x
/// best class. Appends candidates with at least `score_threshold` to `out`; `index` is the row.
/// Throws InvalidArgument if rows are shorter than 5 + classes or classes < 1. O(rows + candidates
/// above the threshold x classes).
void decode_yolov5(MatrixView rows, int classes, float score_threshold,
                   std::vector<Detection>& out);

/// YOLOv8 and YOLO11 (boxes or segmentation): a column a candidate; rows cx, cy, w, h (network
/// pixels), `classes` class probabilities, then anything. Score = best class. `index` is the
/// column. Throws InvalidArgument if there are fewer than 4 + classes rows or classes < 1.
/// O(columns x classes).
void decode_yolov8(MatrixView columns, int classes, float score_threshold,
                   std::vector<Detection>& out);

/// YOLOX, raw export: a row a candidate in the order of strides 8, 16, 32 and of their grids by
/// rows; x = (v0 + column) * stride, y = (v1 + row) * stride, width = exp(v2) * stride, height =
/// exp(v3) * stride, then objectness and `classes` class probabilities. Score = objectness x best
/// class. Throws InvalidArgument if rows are shorter than 5 + classes, or if there are not as many
/// as the grids of an input of `input_width` x `input_height` pixels have cells. Cost as
/// decode_yolov5.
void decode_yolox(MatrixView rows, int classes, int input_width, int input_height,
                  float score_threshold, std::vector<Detection>& out);

/// Darknet's yolo and region layers as OpenCV gives them: a row a candidate; cx, cy, w, h as shares
/// of the input's width and height, objectness, then `classes` scores that already hold the
/// objectness. Throws InvalidArgument if rows are shorter than 5 + classes. Cost as decode_yolov5.
void decode_darknet(MatrixView rows, int classes, int input_width, int input_height,
                    float score_threshold, std::vector<Detection>& out);

}  // namespace dynslam::segmentation
