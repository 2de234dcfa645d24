// Views of OpenCV's images and key points, without a copy. The only header of
// core that needs OpenCV (its core module); include it where you have OpenCV,
// nothing else pulls it in.
#pragma once

#include <cstdint>
#include <type_traits>

#include <opencv2/core/mat.hpp>
#include <opencv2/core/types.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/image_view.hpp"

namespace dynslam {

/// View of a one-channel matrix of element type T (const for reading).
///
/// Throws InvalidArgument if the matrix has another type. An empty matrix gives
/// an empty view. The view shares the pixels and must not outlive the matrix.
/// O(1).
template <typename T>
ImageView<T> as_view(const cv::Mat& image) {
  if (image.empty()) return {};
  constexpr int type = cv::DataType<std::remove_const_t<T>>::type;
  if (image.dims != 2 || image.type() != type) {
    throw_invalid_argument("as_view", "image type", cv::typeToString(image.type()),
                           cv::typeToString(type) + " in two dimensions");
  }
  return {const_cast<T*>(image.ptr<std::remove_const_t<T>>()), image.cols, image.rows,
          static_cast<std::ptrdiff_t>(image.step[0])};
}

/// Matrix header over a view's pixels; writing through it is only valid for a
/// mutable view.
template <typename T>
cv::Mat as_mat(ImageView<T> view) {
  if (view.empty()) return {};
  return cv::Mat(view.height, view.width, cv::DataType<std::remove_const_t<T>>::type,
                 const_cast<std::remove_const_t<T>*>(view.data),
                 static_cast<std::size_t>(view.stride_bytes));
}

}  // namespace dynslam
