#include "segmentation/carried_surfaces.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace dynslam::segmentation {
namespace {

// A corner speaks for the surface around it, half-resolution cells: twice the usual distance to the
// next corner, so that all of a surface with corners hears one.
constexpr int kVoiceCells = 30;
constexpr int kMargin = 3;  // pixels from a mask's border within which a corner belongs to nobody
constexpr int kMinRevealed = 60;            // cells; less is noise of the depth image's borders
constexpr double kMaxRevealedShare = 0.15;  // of the image; more is a part of the room
constexpr std::size_t kMinGroundCorners = 10;

bool covers(const Instance& instance, cv::Point pixel) {
  const cv::Point at = pixel - instance.box.tl();
  return instance.box.contains(pixel) && instance.mask.at<std::uint8_t>(at) != 0;
}

bool one_surface(float a, float b, const DepthRefinementOptions& options) {
  const float step =
      static_cast<float>(options.step_share) * std::min(a, b) + static_cast<float>(options.step_m);
  return std::abs(a - b) <= step;
}

// The cells above, below and beside; how many there are.
int neighbours(int cell, int width, int height, int out[4]) {
  const int x = cell % width;
  const int y = cell / width;
  int count = 0;
  if (x > 0) out[count++] = cell - 1;
  if (x + 1 < width) out[count++] = cell + 1;
  if (y > 0) out[count++] = cell - width;
  if (y + 1 < height) out[count++] = cell + width;
  return count;
}

int cell_at(cv::Point2f at, const HalfDepth& half) {
  const int x = std::clamp(static_cast<int>(std::lround(at.x)), 0, half.width - 1);
  const int y = std::clamp(static_cast<int>(std::lround(at.y)), 0, half.height - 1);
  return y * half.width + x;
}

// The cells of `in`, which covers the mask's window, in the smallest window.
CellMask cut_out(const CellMask& mask, const cv::Mat& in) {
  CellMask part;
  const cv::Rect tight = cv::boundingRect(in);
  if (tight.empty()) return part;
  part.cells = tight + mask.cells.tl();
  part.in = in(tight).clone();
  part.z = mask.z(tight);
  return part;
}

// How the ground moved: from the newest frame back to the older one, by the corners outside all
// masks. False if there are too few.
bool ground_motion(const CarriedCorners& corners, cv::Matx23d& back) {
  std::vector<cv::Point2f> from, to;
  for (std::size_t i = 0; i < corners.pairs.size(); ++i) {
    if (corners.labels[i] != kOutside) continue;
    from.push_back(corners.pairs[i].from);
    to.push_back(corners.pairs[i].to);
  }
  if (from.size() < kMinGroundCorners) return false;
  const cv::Mat motion =
      cv::estimateAffine2D(to, from, cv::noArray(), cv::RANSAC, 2.0, 200, 0.99, 5);
  if (motion.empty()) return false;
  back = motion;
  return true;
}

// Finds the things one by one.
class Revealer {
 public:
  Revealer(const HalfDepth& before, const HalfDepth& now, const std::vector<Instance>& instances,
           const cv::Matx23d& back, const DepthRefinementOptions& options,
           std::vector<std::uint8_t>& taken)
      : before_(before),
        now_(now),
        back_(back),
        options_(options),
        taken_(taken),
        count_(instances.size()),
        who_(before.height, before.width, CV_16SC1, cv::Scalar(-1)) {
    for (std::size_t i = 0; i < instances.size(); ++i) {
      const CellMask mask = cell_mask(instances[i], nullptr);
      who_(mask.cells).setTo(static_cast<double>(i), mask.in);
    }
  }

  std::vector<RevealedThing> operator()() {
    std::vector<RevealedThing> things;
    for (int start = 0; start < now_.width * now_.height; ++start) {
      if (!open(start) || hider(start) < 0) continue;
      flood(start);
      if (is_thing()) things.push_back(thing());
    }
    return things;
  }

 private:
  bool open(int cell) const {
    const auto at = static_cast<std::size_t>(cell);
    return taken_[at] == 0 && measured(now_.z[at]) && now_.facing[at] != 0;
  }
  // The instance that stood before the cell's surface, -1 if none did.
  int hider(int cell) const {
    const int x = cell % now_.width;
    const int y = cell / now_.width;
    const auto sx = static_cast<int>(std::lround(back_(0, 0) * x + back_(0, 1) * y + back_(0, 2)));
    const auto sy = static_cast<int>(std::lround(back_(1, 0) * x + back_(1, 1) * y + back_(1, 2)));
    if (sx < 0 || sy < 0 || sx >= before_.width || sy >= before_.height) return -1;
    const int who = who_.at<std::int16_t>(sy, sx);
    if (who < 0) return -1;
    const float z = before_.at(sx, sy);
    const float limit = (1 - kMaxDepthJump) * now_.z[static_cast<std::size_t>(cell)];
    return !measured(z) || z < limit ? who : -1;
  }
  // Gathers the smooth surface of the cell; counts what its border is beside.
  void flood(int start) {
    cells_.assign(1, start);
    hidden_by_.assign(count_, 0);
    hidden_ = before_others_ = behind_others_ = 0;
    taken_[static_cast<std::size_t>(start)] = 1;
    for (std::size_t next = 0; next < cells_.size(); ++next) {
      const int cell = cells_[next];
      const int who = hider(cell);
      if (who >= 0) {
        ++hidden_;
        ++hidden_by_[static_cast<std::size_t>(who)];
      }
      look_around(cell);
    }
  }
  void look_around(int cell) {
    const float z = now_.z[static_cast<std::size_t>(cell)];
    int around[4];
    const int count = neighbours(cell, now_.width, now_.height, around);
    for (int i = 0; i < count; ++i) {
      const auto at = static_cast<std::size_t>(around[i]);
      const float there = now_.z[at];
      if (taken_[at] != 0 || !measured(there)) continue;
      const bool same = one_surface(there, z, options_);
      if (same && now_.facing[at] != 0) {
        taken_[at] = 1;
        cells_.push_back(around[i]);
      } else if (!same && there > z) {
        ++before_others_;
      } else {
        ++behind_others_;
      }
    }
  }
  bool is_thing() const {
    const std::size_t count = cells_.size();
    return count >= kMinRevealed &&
           static_cast<double>(count) <= kMaxRevealedShare * now_.width * now_.height &&
           2 * hidden_ >= count && before_others_ >= behind_others_;
  }
  RevealedThing thing() const {
    RevealedThing thing;
    thing.mask.cells = cv::Rect(0, 0, now_.width, now_.height);
    thing.mask.in = cv::Mat::zeros(now_.height, now_.width, CV_8UC1);
    for (const int cell : cells_) thing.mask.in.data[cell] = 255;
    const auto most = std::max_element(hidden_by_.begin(), hidden_by_.end());
    thing.hider = static_cast<std::size_t>(most - hidden_by_.begin());
    return thing;
  }

  const HalfDepth& before_;
  const HalfDepth& now_;
  cv::Matx23d back_;
  const DepthRefinementOptions& options_;
  std::vector<std::uint8_t>& taken_;
  std::size_t count_;
  cv::Mat who_;  // instance of every cell of the older frame, -1 = none
  std::vector<int> cells_;
  std::vector<std::size_t> hidden_by_;
  std::size_t hidden_ = 0, before_others_ = 0, behind_others_ = 0;
};

}  // namespace

int label_at(cv::Point2f at, const std::vector<Instance>& instances) {
  const cv::Point pixel(static_cast<int>(std::lround(2 * at.x)),
                        static_cast<int>(std::lround(2 * at.y)));
  int label = kOutside;
  for (std::size_t i = 0; i < instances.size(); ++i) {
    const cv::Rect& box = instances[i].box;
    const cv::Rect reach(box.x - kMargin, box.y - kMargin, box.width + 2 * kMargin,
                         box.height + 2 * kMargin);
    if (!reach.contains(pixel)) continue;
    const bool here = covers(instances[i], pixel);
    for (const cv::Point step : {cv::Point(kMargin, 0), cv::Point(-kMargin, 0),
                                 cv::Point(0, kMargin), cv::Point(0, -kMargin)}) {
      if (covers(instances[i], pixel + step) != here) return kUnknown;
    }
    if (here) label = static_cast<int>(i);
  }
  return label;
}

float median_of(std::vector<float>& values) {
  if (values.empty()) return 0.0F;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

float median_depth(const CellMask& mask) {
  std::vector<float> depths;
  for (int y = 0; y < mask.in.rows; ++y) {
    const std::uint8_t* in = mask.in.ptr(y);
    const auto* z = mask.z.ptr<float>(y);
    for (int x = 0; x < mask.in.cols; x += 2) {
      if (in[x] != 0 && measured(z[x])) depths.push_back(z[x]);
    }
  }
  return median_of(depths);
}

std::vector<CellMask> smooth_parts(const CellMask& mask, const DepthRefinementOptions& options,
                                   int least) {
  std::vector<CellMask> parts;
  CellMask rest = mask;
  rest.in = mask.in.clone();
  const int width = mask.in.cols;
  const int height = mask.in.rows;
  std::vector<std::uint8_t> seen(mask.in.total(), 0);
  std::vector<int> cells;
  for (int start = 0; start < width * height; ++start) {
    const auto usable = [&](int cell) {
      return seen[static_cast<std::size_t>(cell)] == 0 && mask.in.data[cell] != 0 &&
             measured(mask.z.ptr<float>()[cell]);
    };
    if (!usable(start)) continue;
    cells.assign(1, start);
    seen[static_cast<std::size_t>(start)] = 1;
    for (std::size_t next = 0; next < cells.size(); ++next) {
      int around[4];
      const int count = neighbours(cells[next], width, height, around);
      for (int i = 0; i < count; ++i) {
        if (!usable(around[i]) || !one_surface(mask.z.ptr<float>()[around[i]],
                                               mask.z.ptr<float>()[cells[next]], options)) {
          continue;
        }
        seen[static_cast<std::size_t>(around[i])] = 1;
        cells.push_back(around[i]);
      }
    }
    if (cells.size() < static_cast<std::size_t>(least)) continue;
    cv::Mat in = cv::Mat::zeros(mask.in.size(), CV_8UC1);
    for (const int cell : cells) {
      in.data[cell] = 255;
      rest.in.data[cell] = 0;
    }
    parts.push_back(cut_out(mask, in));
  }
  rest = cut_out(mask, rest.in);
  if (rest.cells.empty()) return parts;
  parts.push_back(std::move(rest));
  return parts;
}

void surfaces_from_outside(const HalfDepth& now, const CarriedCorners& corners,
                           const DepthRefinementOptions& options,
                           std::vector<std::uint8_t>& outside) {
  enum : std::uint8_t { kSilent, kIn, kOut };
  outside.assign(now.z.size(), kSilent);
  std::vector<int> ring, next;
  for (std::size_t i = 0; i < corners.pairs.size(); ++i) {
    if (corners.labels[i] == kUnknown) continue;
    const int cell = cell_at(corners.pairs[i].to, now);
    std::uint8_t& state = outside[static_cast<std::size_t>(cell)];
    if (state != kSilent || !measured(now.z[static_cast<std::size_t>(cell)])) continue;
    state = corners.labels[i] == kOutside ? kOut : kIn;
    ring.push_back(cell);
  }
  // From all corners at once, a ring of cells at a time.
  for (int distance = 0; distance < kVoiceCells && !ring.empty(); ++distance) {
    next.clear();
    for (const int cell : ring) {
      const float z = now.z[static_cast<std::size_t>(cell)];
      int around[4];
      const int count = neighbours(cell, now.width, now.height, around);
      for (int i = 0; i < count; ++i) {
        const auto at = static_cast<std::size_t>(around[i]);
        if (outside[at] != kSilent || !measured(now.z[at]) || !one_surface(z, now.z[at], options)) {
          continue;
        }
        outside[at] = outside[static_cast<std::size_t>(cell)];
        next.push_back(around[i]);
      }
    }
    ring.swap(next);
  }
  for (std::uint8_t& state : outside) state = state == kOut ? 1 : 0;
}

void cells_hidden_before(const CellMask& was, cv::Point2f motion, const HalfDepth& before,
                         const HalfDepth& now, int margin, std::vector<std::uint8_t>& hidden) {
  hidden.assign(now.z.size(), 0);
  const float depth = median_depth(was);
  if (depth <= 0.0F) return;
  const float nearer = depth * (1 - kMaxDepthJump);
  const auto dx = static_cast<int>(std::lround(motion.x));
  const auto dy = static_cast<int>(std::lround(motion.y));
  const int left = std::clamp(was.cells.x + dx - margin, 0, now.width);
  const int right = std::clamp(was.cells.br().x + dx + margin, left, now.width);
  for (int y = 0; y < now.height; ++y) {
    const int sy = y - dy;
    const bool row_seen = sy >= 0 && sy < before.height;
    for (int x = left; x < right; ++x) {
      const auto cell = static_cast<std::size_t>(y) * static_cast<std::size_t>(now.width) +
                        static_cast<std::size_t>(x);
      const int sx = x - dx;
      const bool seen = row_seen && sx >= 0 && sx < before.width;
      const float z = seen ? before.at(sx, sy) : 0.0F;
      const bool shown = measured(z) && z >= nearer;
      hidden[cell] = !shown && now.facing[cell] != 0 ? 1 : 0;
    }
  }
}

std::vector<RevealedThing> revealed_things(const HalfDepth& before, const HalfDepth& now,
                                           const std::vector<Instance>& instances,
                                           const CarriedCorners& corners,
                                           const DepthRefinementOptions& options,
                                           std::vector<std::uint8_t>& taken) {
  cv::Matx23d back;
  if (instances.empty() || !ground_motion(corners, back)) return {};
  return Revealer(before, now, instances, back, options, taken)();
}

}  // namespace dynslam::segmentation
