#include "segmentation/mask_carrier.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace dynslam::segmentation {
namespace {

const cv::Size kFlowWindow(15, 15);
constexpr int kFlowLevels = 3;

std::vector<cv::Point2f> corners_inside(const FlowImage& image, const Instance& instance,
                                        int max_points) {
  const cv::Rect box = instance.box;
  const cv::Rect half = cv::Rect(box.x / 2, box.y / 2, (box.width + 1) / 2, (box.height + 1) / 2) &
                        cv::Rect(cv::Point(), image.grey.size());
  if (half.width < 4 || half.height < 4) return {};
  cv::Mat mask;
  cv::resize(instance.mask, mask, half.size(), 0, 0, cv::INTER_NEAREST);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image.grey(half), corners, max_points, 0.01, 4.0, mask, 3);
  for (cv::Point2f& corner : corners) corner += cv::Point2f(half.tl());
  return corners;
}

float median(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Drops the points that move unlike the others: the background at the mask's border.
cv::Point2f keep_the_common_motion(PointTracks& motion) {
  std::vector<float> dx, dy, away;
  for (std::size_t i = 0; i < motion.from.size(); ++i) {
    dx.push_back(motion.to[i].x - motion.from[i].x);
    dy.push_back(motion.to[i].y - motion.from[i].y);
  }
  const cv::Point2f centre(median(dx), median(dy));
  for (std::size_t i = 0; i < dx.size(); ++i) {
    away.push_back(std::hypot(dx[i] - centre.x, dy[i] - centre.y));
  }
  const float limit = 3.0F * 1.4826F * median(away) + 1.5F;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < away.size(); ++i) {
    if (away[i] > limit) continue;
    motion.from[kept] = motion.from[i];
    motion.to[kept++] = motion.to[i];
  }
  motion.from.resize(kept);
  motion.to.resize(kept);
  return centre;
}

// Displacement at a point of the target image, full resolution: neighbours by distance, and the
// common motion where there are none.
cv::Point2f displacement_at(cv::Point2f at, const PointTracks& motion, cv::Point2f common) {
  constexpr float kSigma = 20.0F;  // half-resolution pixels
  float weight = 0.05F;
  cv::Point2f sum = common * weight;
  for (std::size_t i = 0; i < motion.to.size(); ++i) {
    const cv::Point2f d = motion.to[i] - at;
    const float w = std::exp(-d.dot(d) / (2 * kSigma * kSigma));
    sum += (motion.to[i] - motion.from[i]) * w;
    weight += w;
  }
  return sum * (1.0F / weight);
}

// Resamples the mask where the field says it came from.
void warp(const Instance& source, const PointTracks& motion, cv::Point2f common, cv::Size image,
          Instance& target) {
  target = source;
  cv::Rect2f reach(source.box);
  float spread = 0.0F;
  for (std::size_t i = 0; i < motion.to.size(); ++i) {
    const cv::Point2f d = motion.to[i] - motion.from[i] - common;
    spread = std::max(spread, std::max(std::abs(d.x), std::abs(d.y)));
  }
  const float margin = 2 * spread + 2;
  reach = cv::Rect2f(reach.x + 2 * common.x - margin, reach.y + 2 * common.y - margin,
                     reach.width + 2 * margin, reach.height + 2 * margin);
  const cv::Rect box = cv::Rect(cv::Point(static_cast<int>(std::floor(reach.x)),
                                          static_cast<int>(std::floor(reach.y))),
                                cv::Point(static_cast<int>(std::ceil(reach.br().x)),
                                          static_cast<int>(std::ceil(reach.br().y)))) &
                       cv::Rect(cv::Point(), image);
  target.box = cv::Rect();
  target.mask.release();
  if (box.empty()) return;

  // The field on a grid of 16 pixels, then between.
  constexpr int kGrid = 16;
  const cv::Size nodes(box.width / kGrid + 2, box.height / kGrid + 2);
  cv::Mat field(nodes, CV_32FC2);
  for (int y = 0; y < nodes.height; ++y) {
    for (int x = 0; x < nodes.width; ++x) {
      const cv::Point2f at(static_cast<float>(box.x + x * kGrid) / 2,
                           static_cast<float>(box.y + y * kGrid) / 2);
      const cv::Point2f d = displacement_at(at, motion, common) * 2.0F;
      field.at<cv::Vec2f>(y, x) = cv::Vec2f(d.x, d.y);
    }
  }
  cv::Mat map(box.size(), CV_32FC2);
  for (int y = 0; y < box.height; ++y) {
    auto* row = map.ptr<cv::Vec2f>(y);
    const int gy = y / kGrid;
    const float wy = static_cast<float>(y % kGrid) / kGrid;
    for (int x = 0; x < box.width; ++x) {
      const int gx = x / kGrid;
      const float wx = static_cast<float>(x % kGrid) / kGrid;
      const cv::Vec2f d =
          (field.at<cv::Vec2f>(gy, gx) * (1 - wx) + field.at<cv::Vec2f>(gy, gx + 1) * wx) *
              (1 - wy) +
          (field.at<cv::Vec2f>(gy + 1, gx) * (1 - wx) + field.at<cv::Vec2f>(gy + 1, gx + 1) * wx) *
              wy;
      row[x] = cv::Vec2f(static_cast<float>(box.x + x - source.box.x) - d[0],
                         static_cast<float>(box.y + y - source.box.y) - d[1]);
    }
  }
  cv::Mat mask;
  cv::remap(source.mask, mask, map, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  cv::threshold(mask, mask, 127, 255, cv::THRESH_BINARY);
  const cv::Rect tight = cv::boundingRect(mask);
  if (tight.empty()) return;
  target.mask = mask(tight).clone();
  target.box = tight + box.tl();
}

}  // namespace

FlowImage make_flow_image(const cv::Mat& image) {
  FlowImage flow;
  flow.full = image.size();
  cv::Mat half;
  const cv::Size size(std::max(image.cols / 2, 1), std::max(image.rows / 2, 1));
  cv::resize(image, half, size, 0, 0, cv::INTER_AREA);
  if (half.channels() == 1) {
    flow.grey = half;
  } else {
    cv::cvtColor(half, flow.grey, half.channels() == 3 ? cv::COLOR_BGR2GRAY : cv::COLOR_BGRA2GRAY);
  }
  if (std::min(size.width, size.height) > kFlowWindow.width) {
    cv::buildOpticalFlowPyramid(flow.grey, flow.pyramid, kFlowWindow, kFlowLevels);
  }
  return flow;
}

std::vector<PointTracks> start_tracks(const FlowImage& image,
                                      const std::vector<Instance>& instances,
                                      const CarryOptions& options) {
  std::vector<PointTracks> tracks(instances.size());
  if (image.pyramid.empty()) return tracks;
  for (std::size_t i = 0; i < instances.size(); ++i) {
    tracks[i].from = corners_inside(image, instances[i], options.max_points);
    tracks[i].to = tracks[i].from;
    tracks[i].step.assign(tracks[i].from.size(), cv::Point2f(0, 0));
    tracks[i].tried = static_cast<int>(tracks[i].from.size());
  }
  return tracks;
}

void advance_tracks(std::vector<PointTracks>& tracks, const FlowImage& from, const FlowImage& to,
                    const CarryOptions& options) {
  // All corners go through the flow together, from where their last step would bring them, and
  // back.
  std::vector<cv::Point2f> start, end;
  for (const PointTracks& track : tracks) {
    start.insert(start.end(), track.to.begin(), track.to.end());
    for (std::size_t k = 0; k < track.to.size(); ++k) end.push_back(track.to[k] + track.step[k]);
  }
  if (start.empty() || from.pyramid.empty() || to.pyramid.empty()) return;
  std::vector<cv::Point2f> back = start;
  std::vector<std::uint8_t> found, found_back;
  std::vector<float> error;
  const cv::TermCriteria stop(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 15, 0.03);
  cv::calcOpticalFlowPyrLK(from.pyramid, to.pyramid, start, end, found, error, kFlowWindow,
                           kFlowLevels, stop, cv::OPTFLOW_USE_INITIAL_FLOW);
  cv::calcOpticalFlowPyrLK(to.pyramid, from.pyramid, end, back, found_back, error, kFlowWindow, 1,
                           stop, cv::OPTFLOW_USE_INITIAL_FLOW);
  const float limit = static_cast<float>(options.max_error_px / 2);
  const cv::Rect2f inside(0, 0, static_cast<float>(to.grey.cols), static_cast<float>(to.grey.rows));
  std::size_t at = 0;
  for (PointTracks& track : tracks) {
    std::size_t kept = 0;
    for (std::size_t k = 0; k < track.to.size(); ++k, ++at) {
      const cv::Point2f d = back[at] - start[at];
      if (found[at] == 0 || found_back[at] == 0 || !(d.dot(d) <= limit * limit) ||
          !inside.contains(end[at])) {
        continue;
      }
      track.from[kept] = track.from[k];
      track.step[kept] = end[at] - start[at];
      track.to[kept++] = end[at];
    }
    track.from.resize(kept);
    track.step.resize(kept);
    track.to.resize(kept);
  }
}

void drop_foreign_corners(std::vector<PointTracks>& tracks, DepthView depth,
                          const std::vector<float>& expected) {
  if (depth.empty()) return;
  for (std::size_t i = 0; i < tracks.size(); ++i) {
    PointTracks& track = tracks[i];
    if (expected[i] <= 0.0F) continue;
    std::vector<std::size_t> good;
    for (std::size_t k = 0; k < track.to.size(); ++k) {
      const int x =
          std::clamp(static_cast<int>(std::lround(2 * track.to[k].x)), 0, depth.width - 1);
      const int y =
          std::clamp(static_cast<int>(std::lround(2 * track.to[k].y)), 0, depth.height - 1);
      const float z = depth(x, y);
      const bool off = z > 0.0F && std::abs(z - expected[i]) > kMaxDepthJump * expected[i];
      if (!off) good.push_back(k);
    }
    if (2 * good.size() < track.to.size()) continue;
    for (std::size_t k = 0; k < good.size(); ++k) {
      track.from[k] = track.from[good[k]];
      track.to[k] = track.to[good[k]];
      track.step[k] = track.step[good[k]];
    }
    track.from.resize(good.size());
    track.to.resize(good.size());
    track.step.resize(good.size());
  }
}

std::vector<CarriedInstance> move_instances(const std::vector<Instance>& instances,
                                            const std::vector<PointTracks>& tracks, cv::Size full) {
  std::vector<CarriedInstance> moved(instances.size());
  for (std::size_t i = 0; i < instances.size(); ++i) {
    PointTracks track = tracks[i];
    cv::Point2f common(0, 0);
    if (!track.from.empty()) common = keep_the_common_motion(track);
    moved[i].tracked = track.tracked();
    warp(instances[i], track, common, full, moved[i].instance);
  }
  return moved;
}

std::vector<CarriedInstance> carry_instances(const FlowImage& from, const FlowImage& to,
                                             const std::vector<Instance>& instances,
                                             const CarryOptions& options) {
  auto tracks = start_tracks(from, instances, options);
  advance_tracks(tracks, from, to, options);
  return move_instances(instances, tracks, to.full);
}

float median_depth(const Instance& instance, DepthView depth) {
  if (depth.empty()) return 0.0F;
  std::vector<float> values;
  for (int y = 0; y < instance.box.height; y += 2) {
    const std::uint8_t* mask = instance.mask.ptr(y);
    const float* row = depth.row(instance.box.y + y) + instance.box.x;
    for (int x = 0; x < instance.box.width; x += 2) {
      if (mask[x] != 0 && row[x] > 0.0F && std::isfinite(row[x])) values.push_back(row[x]);
    }
  }
  if (values.size() < 8) return 0.0F;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double keep_depth(Instance& instance, DepthView depth, float expected) {
  if (depth.empty() || expected <= 0.0F) return 1.0;
  instance.mask = instance.mask.clone();
  int measured = 0;
  int kept = 0;
  for (int y = 0; y < instance.box.height; ++y) {
    std::uint8_t* mask = instance.mask.ptr(y);
    const float* row = depth.row(instance.box.y + y) + instance.box.x;
    for (int x = 0; x < instance.box.width; ++x) {
      if (mask[x] == 0 || !(row[x] > 0.0F)) continue;
      ++measured;
      if (std::abs(row[x] - expected) <= kMaxDepthJump * expected) {
        ++kept;
      } else {
        mask[x] = 0;
      }
    }
  }
  return measured > 0 ? static_cast<double>(kept) / measured : 1.0;
}

double Overlap::iou() const {
  const int any = first + second - both;
  return any > 0 ? static_cast<double>(both) / any : 0.0;
}

double Overlap::of_smaller() const {
  const int smaller = std::min(first, second);
  return smaller > 0 ? static_cast<double>(both) / smaller : 0.0;
}

Overlap overlap_of(const Instance& first, const Instance& second) {
  Overlap overlap;
  overlap.first = cv::countNonZero(first.mask);
  overlap.second = cv::countNonZero(second.mask);
  const cv::Rect common = first.box & second.box;
  if (!common.empty()) {
    overlap.both = cv::countNonZero(first.mask(common - first.box.tl()) &
                                    second.mask(common - second.box.tl()));
  }
  return overlap;
}

}  // namespace dynslam::segmentation
