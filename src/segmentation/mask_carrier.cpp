#include "segmentation/mask_carrier.hpp"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

namespace dynslam::segmentation {
namespace {

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

// The motion that most of the others are like: half of them may be wrong, each in its own way.
cv::Point2f most_common(const std::vector<cv::Point2f>& motions) {
  constexpr float kAlike = 2.0F;  // half-resolution pixels
  std::size_t most = 0;
  cv::Point2f best(0, 0);
  for (const cv::Point2f& candidate : motions) {
    std::size_t alike = 0;
    cv::Point2f sum(0, 0);
    for (const cv::Point2f& other : motions) {
      const cv::Point2f d = other - candidate;
      if (d.dot(d) > kAlike * kAlike) continue;
      ++alike;
      sum += other;
    }
    if (alike > most) {
      most = alike;
      best = sum * (1.0F / static_cast<float>(alike));
    }
  }
  return best;
}

}  // namespace

cv::Point2f keep_the_common_motion(PointTracks& motion) {
  std::vector<cv::Point2f> motions;
  for (std::size_t i = 0; i < motion.from.size(); ++i) {
    motions.push_back(motion.to[i] - motion.from[i]);
  }
  const cv::Point2f centre = most_common(motions);
  std::vector<float> away;
  for (const cv::Point2f& d : motions) away.push_back(std::hypot(d.x - centre.x, d.y - centre.y));
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

namespace {

// A bell curve around `centre` at the `count` places `first`, `first + step` ..., from the nearest
// one outwards: each value is the one before times a ratio that falls by the same factor.
void bell_curve(float centre, int first, int step, std::size_t count, float* values) {
  constexpr float kSigma = 20.0F;  // half-resolution pixels
  constexpr float kScale = 1.0F / (2 * kSigma * kSigma);
  const auto h = static_cast<float>(step);
  const float place = std::round((centre - static_cast<float>(first)) / h);
  const auto last = static_cast<float>(count - 1);
  const auto nearest = static_cast<std::size_t>(std::clamp(place, 0.0F, last));
  const float d = static_cast<float>(first) + static_cast<float>(nearest) * h - centre;
  const float fall = std::exp(-2 * h * h * kScale);
  values[nearest] = std::exp(-d * d * kScale);
  float ratio = std::exp(-(h * h + 2 * h * d) * kScale);
  for (std::size_t i = nearest + 1; i < count; ++i, ratio *= fall) {
    values[i] = values[i - 1] * ratio;
  }
  ratio = std::exp(-(h * h - 2 * h * d) * kScale);
  for (std::size_t i = nearest; i > 0; --i, ratio *= fall) values[i - 1] = values[i] * ratio;
}

// Displacements at the nodes of a grid, CV_32FC1.
struct Displacements {
  cv::Mat x;
  cv::Mat y;
};

// Over `cells`, nodes every `step` cells: neighbours by distance, and the common motion where there
// are none.
Displacements displacement_field(const cv::Rect& cells, int step, const PointTracks& motion,
                                 cv::Point2f common) {
  constexpr float kCommonWeight = 0.05F;
  const cv::Size nodes(cells.width / step + 2, cells.height / step + 2);
  const auto columns = static_cast<std::size_t>(nodes.width);
  const auto rows = static_cast<std::size_t>(nodes.height);
  // The weight of a corner at a node is a product of one for the column and one for the row.
  std::vector<float> by_column(columns), by_row(rows);
  cv::Mat sums[3];  // displacement times weight, x and y, and weight
  for (int i = 0; i < 3; ++i) {
    const float start[] = {common.x, common.y, 1.0F};
    sums[i] = cv::Mat(nodes, CV_32FC1, cv::Scalar(kCommonWeight * start[i]));
  }
  for (std::size_t i = 0; i < motion.to.size(); ++i) {
    const cv::Point2f d = motion.to[i] - motion.from[i];
    bell_curve(motion.to[i].x, cells.x, step, columns, by_column.data());
    bell_curve(motion.to[i].y, cells.y, step, rows, by_row.data());
    for (std::size_t y = 0; y < rows; ++y) {
      auto* sum_x = sums[0].ptr<float>(static_cast<int>(y));
      auto* sum_y = sums[1].ptr<float>(static_cast<int>(y));
      auto* weight = sums[2].ptr<float>(static_cast<int>(y));
      for (std::size_t x = 0; x < columns; ++x) {
        const float w = by_column[x] * by_row[y];
        sum_x[x] += d.x * w;
        sum_y[x] += d.y * w;
        weight[x] += w;
      }
    }
  }
  return {sums[0] / sums[2], sums[1] / sums[2]};
}

// The nearest whole number, for numbers above -10000; std::lround is a call.
int nearest(float value) { return static_cast<int>(value + 10000.5F) - 10000; }

constexpr int kGrid = 8;  // cells from node to node of a displacement field

// The displacements of the cells of row `y`, in one direction.
void displacements_of_row(const cv::Mat& field, int y, std::vector<float>& moved) {
  const auto* above = field.ptr<float>(y / kGrid);
  const auto* below = field.ptr<float>(y / kGrid + 1);
  const float wy = static_cast<float>(y % kGrid) / kGrid;
  const auto at_node = [=](int node) { return above[node] * (1 - wy) + below[node] * wy; };
  float* out = moved.data();
  float left = at_node(0);
  for (int node = 1; node < field.cols; ++node, out += kGrid) {
    const float right = at_node(node);
    for (int i = 0; i < kGrid; ++i) {
      const float w = static_cast<float>(i) / kGrid;
      out[i] = left * (1 - w) + right * w;
    }
    left = right;
  }
}

}  // namespace

cv::Rect cells_of(const cv::Rect& box) {
  const int x = box.x / 2;
  const int y = box.y / 2;
  return {x, y, (box.br().x + 1) / 2 - x, (box.br().y + 1) / 2 - y};
}

cv::Rect reach_of(const cv::Rect& cells, const PointTracks& motion, cv::Point2f common) {
  cv::Point2f least = common, most = common;
  for (std::size_t i = 0; i < motion.to.size(); ++i) {
    const cv::Point2f d = motion.to[i] - motion.from[i];
    least = {std::min(least.x, d.x), std::min(least.y, d.y)};
    most = {std::max(most.x, d.x), std::max(most.y, d.y)};
  }
  const auto low = [](float v) { return static_cast<int>(std::floor(v)) - 1; };
  const auto high = [](float v) { return static_cast<int>(std::ceil(v)) + 1; };
  return {cv::Point(cells.x + low(least.x), cells.y + low(least.y)),
          cv::Point(cells.br().x + high(most.x), cells.br().y + high(most.y))};
}

CellMask cell_mask(const Instance& instance, const HalfDepth* depth) {
  CellMask mask;
  mask.cells = cells_of(instance.box);
  mask.in.create(mask.cells.size(), CV_8UC1);
  mask.z.create(mask.cells.size(), CV_32FC1);
  // Cell 0 of a box that begins at an odd pixel would be outside of it.
  const int left = 2 * mask.cells.x - instance.box.x;
  const int top = 2 * mask.cells.y - instance.box.y;
  for (int y = 0; y < mask.cells.height; ++y) {
    const std::uint8_t* source = instance.mask.ptr(std::max(top + 2 * y, 0));
    std::uint8_t* in = mask.in.ptr(y);
    in[0] = source[0];
    for (int x = 1; x < mask.cells.width; ++x) in[x] = source[left + 2 * x];
    auto* z = mask.z.ptr<float>(y);
    if (depth != nullptr) {
      const float* row =
          depth->z.data() + static_cast<std::ptrdiff_t>(mask.cells.y + y) * depth->width;
      std::copy_n(row + mask.cells.x, mask.cells.width, z);
    } else {
      std::fill_n(z, mask.cells.width, 0.0F);
    }
  }
  return mask;
}

CellMask move_cells(const CellMask& source, const PointTracks& motion, cv::Point2f common,
                    cv::Size half) {
  CellMask target;
  target.cells = reach_of(source.cells, motion, common) & cv::Rect(cv::Point(), half);
  if (target.cells.empty()) return target;
  target.in = cv::Mat::zeros(target.cells.size(), CV_8UC1);
  target.z = cv::Mat::zeros(target.cells.size(), CV_32FC1);
  const Displacements field = displacement_field(target.cells, kGrid, motion, common);
  const cv::Point offset = target.cells.tl() - source.cells.tl();
  const auto width = static_cast<unsigned>(source.cells.width);
  const auto height = static_cast<unsigned>(source.cells.height);
  const std::uint8_t* source_in = source.in.data;
  const auto* source_z = source.z.ptr<float>();
  const std::size_t in_step = source.in.step1();
  const std::size_t z_step = source.z.step1();
  std::vector<float> moved_x(static_cast<std::size_t>(field.x.cols * kGrid));
  std::vector<float> moved_y(moved_x.size());
  for (int y = 0; y < target.cells.height; ++y) {
    displacements_of_row(field.x, y, moved_x);
    displacements_of_row(field.y, y, moved_y);
    std::uint8_t* in = target.in.ptr(y);
    auto* z = target.z.ptr<float>(y);
    const auto own_y = static_cast<float>(offset.y + y);
    for (int x = 0; x < target.cells.width; ++x) {
      const auto i = static_cast<std::size_t>(x);
      const auto sx = static_cast<unsigned>(nearest(static_cast<float>(offset.x + x) - moved_x[i]));
      const auto sy = static_cast<unsigned>(nearest(own_y - moved_y[i]));
      if (sx >= width || sy >= height || source_in[sy * in_step + sx] == 0) continue;
      in[x] = source_in[sy * in_step + sx];
      z[x] = source_z[sy * z_step + sx];
    }
  }
  return target;
}

void paint_cells(const CellMask& mask, cv::Size full, Instance& instance) {
  instance.box = cv::Rect();
  instance.mask.release();
  if (mask.cells.empty()) return;
  const cv::Rect tight = cv::boundingRect(mask.in);
  if (tight.empty()) return;
  cv::Mat large;
  cv::resize(mask.in(tight), large, cv::Size(2 * tight.width, 2 * tight.height), 0, 0,
             cv::INTER_NEAREST);
  const cv::Point corner = 2 * (mask.cells.tl() + tight.tl());
  instance.box = cv::Rect(corner, large.size()) & cv::Rect(cv::Point(), full);
  if (instance.box.empty()) return;
  instance.mask = large(instance.box - corner).clone();
}

namespace {

cv::Size half_of(cv::Size full) { return {(full.width + 1) / 2, (full.height + 1) / 2}; }

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

std::vector<CarriedInstance> move_instances(const std::vector<Instance>& instances,
                                            const std::vector<PointTracks>& tracks, cv::Size full) {
  std::vector<CarriedInstance> moved(instances.size());
  for (std::size_t i = 0; i < instances.size(); ++i) {
    PointTracks track = tracks[i];
    cv::Point2f common(0, 0);
    if (!track.from.empty()) common = keep_the_common_motion(track);
    moved[i].tracked = track.tracked();
    moved[i].instance = instances[i];
    paint_cells(move_cells(cell_mask(instances[i], nullptr), track, common, half_of(full)), full,
                moved[i].instance);
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
