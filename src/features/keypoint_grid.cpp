#include "dynslam/features/keypoint_grid.hpp"

#include <algorithm>
#include <cmath>

#include "dynslam/core/errors.hpp"

namespace dynslam::features {

void KeypointGrid::build(StridedSpan<const cv::Point2f> positions, int width, int height,
                         int cell_size) {
  constexpr const char* where = "KeypointGrid::build";
  require(width >= 1, where, "width", width, ">= 1");
  require(height >= 1, where, "height", height, ">= 1");
  require(cell_size >= 1, where, "cell_size", cell_size, ">= 1");

  columns_ = (width - 1) / cell_size + 1;
  rows_ = (height - 1) / cell_size + 1;
  cells_per_pixel_ = 1.0F / static_cast<float>(cell_size);
  size_ = positions.size();
  const std::size_t cells = static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_);
  starts_.assign(cells + 1, 0);
  const auto cell_of = [&](const cv::Point2f& p) {
    return static_cast<std::size_t>(row_of(p.y)) * static_cast<std::size_t>(columns_) +
           static_cast<std::size_t>(column_of(p.x));
  };
  const auto has_nan = [](const cv::Point2f& p) { return std::isnan(p.x) || std::isnan(p.y); };

  // Counting sort: each start first holds its cell's end and is walked back.
  for (const cv::Point2f& p : positions) {
    if (!has_nan(p)) ++starts_[cell_of(p)];
  }
  std::int32_t sum = 0;
  for (std::int32_t& start : starts_) start = sum += start;
  entries_.resize(static_cast<std::size_t>(sum));
  for (std::size_t i = size_; i-- > 0;) {
    const cv::Point2f& p = positions[i];
    if (has_nan(p)) continue;
    const std::int32_t at = --starts_[cell_of(p)];
    entries_[static_cast<std::size_t>(at)] = {p.x, p.y, static_cast<std::int32_t>(i)};
  }
}

/// Cell of a coordinate, positions outside the image counted to the border. Not for NaN.
int KeypointGrid::column_of(float x) const {
  const float column = std::floor(x * cells_per_pixel_);
  return static_cast<int>(std::clamp(column, 0.0F, static_cast<float>(columns_ - 1)));
}

int KeypointGrid::row_of(float y) const {
  const float row = std::floor(y * cells_per_pixel_);
  return static_cast<int>(std::clamp(row, 0.0F, static_cast<float>(rows_ - 1)));
}

KeypointGrid::Cells KeypointGrid::cells_of(cv::Point2f centre, float radius) const {
  constexpr Cells none = {0, 0, 0, -1};
  // Written so that NaN fails.
  if (entries_.empty() || !(radius >= 0.0F)) return none;
  const float left = centre.x - radius;
  const float right = centre.x + radius;
  const float top = centre.y - radius;
  const float bottom = centre.y + radius;
  if (std::isnan(left + right) || std::isnan(top + bottom)) return none;
  return {column_of(left), column_of(right), row_of(top), row_of(bottom)};
}

void KeypointGrid::find(cv::Point2f centre, float radius,
                        std::vector<std::int32_t>& indices) const {
  indices.clear();
  visit(centre, radius, [&](std::int32_t index) { indices.push_back(index); });
  std::sort(indices.begin(), indices.end());
}

}  // namespace dynslam::features
