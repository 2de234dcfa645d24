// What is made of a frame's images before features are matched.
#pragma once

#include <opencv2/core/mat.hpp>

namespace dynslam::slam {

/// Mean brightness of the whole cells of `kSurfaceCell` pixels a side, rounded, half to even: what
/// cv::resize with INTER_AREA gives. CV_8UC1 both. O(pixels).
void mean_of_cells(const cv::Mat& gray, cv::Mat& cells);

/// Splits a depth image (CV_32FC1) by a mask (CV_8UC1, 0 = seen): `seen` is the image with 0 under
/// the mask; `hidden` holds at least what is under the mask, the rest of it is of no meaning.
/// Writes into the memory that is there. O(pixels).
void split_depth(const cv::Mat& depth, const cv::Mat& mask, cv::Mat& seen, cv::Mat& hidden);

}  // namespace dynslam::slam
