#include "segmentation/corner_tracker.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace dynslam::segmentation {
namespace {

constexpr int kMinCell = 8;       // half-resolution pixels between corners, at least
constexpr double kCorners = 350;  // about so many in any image
constexpr int kMostInField = 3;
constexpr int kBorder = 3;
constexpr int kFineLevels = 1;  // above the first, for corners that move nearly as they did
// Of the strongest corner; weaker ones are noise. Lower than what a tracker of a few good corners
// would take, because every part of the image is to have one.
constexpr double kQuality = 0.002;

float depth_at(const std::vector<float>& z, cv::Size size, cv::Point2f at) {
  if (z.empty()) return 0.0F;
  const int x = std::clamp(static_cast<int>(std::lround(at.x)), 0, size.width - 1);
  const int y = std::clamp(static_cast<int>(std::lround(at.y)), 0, size.height - 1);
  return z[static_cast<std::size_t>(y) * static_cast<std::size_t>(size.width) +
           static_cast<std::size_t>(x)];
}

}  // namespace

CornerGrid::CornerGrid(cv::Size image, const std::vector<cv::Rect>& close)
    : cell(std::max(kMinCell, static_cast<int>(std::sqrt(image.area() / kCorners)))),
      columns((image.width + cell - 1) / cell),
      rows((image.height + cell - 1) / cell),
      is_close(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows), 0) {
  for (const cv::Rect& window : close) {
    const cv::Rect inside = window & cv::Rect(cv::Point(), image);
    for (int y = inside.y / cell; y * cell < inside.br().y; ++y) {
      for (int x = inside.x / cell; x * cell < inside.br().x; ++x) {
        is_close[static_cast<std::size_t>(y * columns + x)] = 1;
      }
    }
  }
}

std::size_t CornerGrid::field_of(int column, int row) const {
  const auto own = static_cast<std::size_t>(row * columns + column);
  if (is_close[own] != 0) return own;
  return static_cast<std::size_t>(row / 2 * 2 * columns + column / 2 * 2);
}

std::size_t CornerGrid::field_of(const Corner& corner) const {
  return field_of(static_cast<int>(corner.at.x) / cell, static_cast<int>(corner.at.y) / cell);
}

// Where the corners `start` of the last image are in `image`, from `end` on; `found` says which
// came back to where they began.
void CornerTracker::flow(const FlowImage& image, int levels, const std::vector<cv::Point2f>& start,
                         std::vector<cv::Point2f>& end, std::vector<std::uint8_t>& found) const {
  const cv::TermCriteria stop(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 10, 0.03);
  cv::calcOpticalFlowPyrLK(last_.pyramid, image.pyramid, start, end, found, cv::noArray(),
                           kFlowWindow, levels, stop, cv::OPTFLOW_USE_INITIAL_FLOW);
  // The way back is to end a pixel from where it is begun: no need of coarse levels.
  std::vector<cv::Point2f> back = start;
  std::vector<std::uint8_t> found_back;
  cv::calcOpticalFlowPyrLK(image.pyramid, last_.pyramid, end, back, found_back, cv::noArray(),
                           kFlowWindow, 0, stop, cv::OPTFLOW_USE_INITIAL_FLOW);
  const float limit = static_cast<float>(max_error_px_ / 2);
  for (std::size_t i = 0; i < start.size(); ++i) {
    const cv::Point2f d = back[i] - start[i];
    if (found_back[i] == 0 || !(d.dot(d) <= limit * limit)) found[i] = 0;
  }
}

std::vector<Corner> CornerTracker::follow(const FlowImage& image, const HalfDepth& depth) const {
  std::vector<Corner> followed;
  if (corners_.empty() || corners_.back().empty() || image.pyramid.empty()) return followed;
  std::vector<cv::Point2f> start, end;
  for (const Corner& corner : corners_.back()) {
    start.push_back(corner.at);
    end.push_back(corner.at + corner.step);
  }
  std::vector<std::uint8_t> found;
  flow(image, kFineLevels, start, end, found);
  // Few move so unlike before that it takes the coarse levels to find them.
  std::vector<std::size_t> lost;
  std::vector<cv::Point2f> lost_start, lost_end;
  for (std::size_t i = 0; i < start.size(); ++i) {
    if (found[i] != 0) continue;
    lost.push_back(i);
    lost_start.push_back(start[i]);
    lost_end.push_back(start[i] + corners_.back()[i].step);
  }
  if (!lost.empty()) {
    std::vector<std::uint8_t> refound;
    flow(image, kFlowLevels, lost_start, lost_end, refound);
    for (std::size_t k = 0; k < lost.size(); ++k) {
      found[lost[k]] = refound[k];
      end[lost[k]] = lost_end[k];
    }
  }
  const cv::Size size = image.grey.size();
  const cv::Rect2f inside(0, 0, static_cast<float>(size.width), static_cast<float>(size.height));
  for (std::size_t i = 0; i < start.size(); ++i) {
    if (found[i] == 0 || !inside.contains(end[i])) continue;
    const float before = depth_at(last_depth_, size, start[i]);
    const float now = depth_at(depth.z, size, end[i]);
    if (measured(before) && measured(now) && std::abs(now - before) > kMaxDepthJump * before) {
      continue;
    }
    followed.push_back({end[i], end[i] - start[i], static_cast<int>(i)});
  }
  return followed;
}

// Where things come one before the other, corners crowd; a few in a field say as much. Counts the
// corners of every field of the grid.
void CornerTracker::thin_out(const CornerGrid& grid, std::vector<Corner>& corners) {
  count_.assign(static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows), 0);
  const auto crowded = [&](const Corner& corner) {
    return ++count_[grid.field_of(corner)] > kMostInField;
  };
  corners.erase(std::remove_if(corners.begin(), corners.end(), crowded), corners.end());
}

// A new corner in every field that has none, of the rows of cells from `first` to before `last`.
void CornerTracker::fill_gaps(const cv::Mat& grey, const CornerGrid& grid, int first, int last,
                              std::vector<Corner>& corners) {
  if (first >= last) return;
  const cv::Size size = grey.size();
  const int top = first * grid.cell;
  const int end = std::min(last * grid.cell, size.height);
  cv::cornerMinEigenVal(grey.rowRange(top, end), strength_, 3);
  double strongest = 0.0;
  cv::minMaxLoc(strength_, nullptr, &strongest);
  strongest_[first == 0 ? 0 : 1] = strongest;
  const auto least =
      static_cast<float>(kQuality * *std::max_element(strongest_.begin(), strongest_.end()));
  for (int gy = first; gy < last; ++gy) {
    for (int gx = 0; gx < grid.columns; ++gx) {
      int& count = count_[grid.field_of(gx, gy)];
      if (count > 0) continue;
      float best = least;
      cv::Point at(-1, -1);
      const int bottom = std::min((gy + 1) * grid.cell, size.height - kBorder);
      const int right = std::min((gx + 1) * grid.cell, size.width - kBorder);
      for (int y = std::max(gy * grid.cell, kBorder); y < bottom; ++y) {
        const float* row = strength_.ptr<float>(y - top);
        for (int x = std::max(gx * grid.cell, kBorder); x < right; ++x) {
          if (row[x] > best) {
            best = row[x];
            at = {x, y};
          }
        }
      }
      if (at.x < 0) continue;
      corners.push_back({cv::Point2f(at), cv::Point2f(0, 0), -1});
      ++count;
    }
  }
}

// Corners for the fields that lost theirs: in every frame for one half of the image, which costs
// half as much and is soon enough, since a mask comes frames late; for all of the first.
void CornerTracker::renew(const cv::Mat& grey, const std::vector<cv::Rect>& close,
                          std::vector<Corner>& corners) {
  const CornerGrid grid(grey.size(), close);
  thin_out(grid, corners);
  const int middle = grid.rows / 2;
  const bool all = corners.empty();
  if (all || upper_) fill_gaps(grey, grid, 0, middle, corners);
  if (all || !upper_) fill_gaps(grey, grid, middle, grid.rows, corners);
  upper_ = !upper_;
}

void CornerTracker::add(FlowImage image, const HalfDepth& depth,
                        const std::vector<cv::Rect>& close) {
  std::vector<Corner> corners = follow(image, depth);
  if (!image.pyramid.empty()) renew(image.grey, close, corners);
  corners_.push_back(std::move(corners));
  while (corners_.size() > history_) corners_.pop_front();
  last_ = std::move(image);
  last_depth_ = depth.z;
}

std::vector<CornerPair> CornerTracker::pairs_since(std::size_t place) const {
  std::vector<CornerPair> pairs;
  if (place >= corners_.size()) return pairs;
  for (const Corner& corner : corners_.back()) {
    const Corner* at = &corner;
    std::size_t frame = corners_.size() - 1;
    while (frame > place && at->previous >= 0) {
      at = &corners_[--frame][static_cast<std::size_t>(at->previous)];
    }
    if (frame == place) pairs.push_back({at->at, corner.at});
  }
  return pairs;
}

}  // namespace dynslam::segmentation
