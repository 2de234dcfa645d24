#include "segmentation/carried_surfaces.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace dynslam::segmentation {
namespace {

constexpr int kMargin = 3;  // pixels from a mask's border within which a corner belongs to nobody
constexpr int kMinRevealed = 60;            // cells; less is noise of the depth image's borders
constexpr double kMaxRevealedShare = 0.15;  // of the image; more is a part of the room
constexpr double kRounding = 2.0;           // cells that a moved window is wider for safety
constexpr std::size_t kMinGroundCorners = 10;

bool covers(const Instance& instance, cv::Point pixel) {
  const cv::Point at = pixel - instance.box.tl();
  return instance.box.contains(pixel) && instance.mask.at<std::uint8_t>(at) != 0;
}

cv::Point cell_at(cv::Point2f at, const HalfDepth& half) {
  return {std::clamp(static_cast<int>(std::lround(at.x)), 0, half.width - 1),
          std::clamp(static_cast<int>(std::lround(at.y)), 0, half.height - 1)};
}

// The nearest whole number, for numbers above -10000; std::lround is a call.
int nearest(double value) { return static_cast<int>(value + 10000.5) - 10000; }

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

// The depths of a row's cells that are in a mask, else 0. Without branches, so that it is
// vectorized.
void keep_masked(const std::uint8_t* in, const float* z, int width, float* out) {
  for (int x = 0; x < width; ++x) {
    const float there = z[x];
    out[x] = in[x] != 0 ? there : 0.0F;
  }
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

// What a search for revealed things must know of a cell.
enum CellState : std::uint8_t { kFacing = 1, kClosed = 2 };

// The states of a row of cells: closed is what is taken or has no depth. Without branches, so that
// it is vectorized.
void close_row(const std::uint8_t* facing, const std::uint8_t* taken, const float* z, int width,
               std::uint8_t* states) {
  for (int x = 0; x < width; ++x) {
    const int open = (taken[x] == 0 ? 1 : 0) & (measured(z[x]) ? 1 : 0);
    const int face = facing[x] != 0 ? kFacing : 0;
    states[x] = static_cast<std::uint8_t>(face | (open != 0 ? 0 : kClosed));
  }
}

// Finds the things one by one.
class Revealer {
 public:
  Revealer(const HalfDepth& before, const HalfDepth& now, const std::vector<Instance>& instances,
           const cv::Matx23d& back, const DepthRefinementOptions& options,
           const std::vector<std::uint8_t>& taken)
      : before_(before),
        now_(now),
        back_(back),
        step_(options),
        most_(static_cast<std::size_t>(kMaxRevealedShare * now.width * now.height)),
        count_(instances.size()),
        who_(before.height, before.width, CV_16SC1, cv::Scalar(-1)) {
    depth_.cut(now, cv::Rect(0, 0, now.width, now.height));
    state_.assign(depth_.z.size(), kClosed);
    for (int y = 0; y < now.height; ++y) {
      const auto row = static_cast<std::ptrdiff_t>(y) * now.width;
      close_row(now.facing.data() + row, taken.data() + row, now.z.data() + row, now.width,
                state_.data() + depth_.cell_of(0, y));
    }
    for (std::size_t i = 0; i < instances.size(); ++i) {
      const CellMask mask = cell_mask(instances[i], nullptr);
      who_(mask.cells).setTo(static_cast<double>(i), mask.in);
      all_ = i == 0 ? mask.cells : all_ | mask.cells;
    }
  }

  std::vector<RevealedThing> operator()() {
    std::vector<RevealedThing> things;
    const cv::Rect window = behind_instances();
    for (int y = window.y; y < window.br().y; ++y) {
      for (int x = window.x; x < window.br().x; ++x) {
        const int start = depth_.cell_of(x, y);
        if (state_[static_cast<std::size_t>(start)] != kFacing) continue;
        if (hider(x, y, depth_.at(start)) < 0) continue;
        flood(start);
        if (is_thing()) things.push_back(thing());
      }
    }
    return things;
  }

 private:
  // Where the cells are now that an instance was in.
  cv::Rect behind_instances() const {
    cv::Matx23d forward;
    cv::invertAffineTransform(back_, forward);
    cv::Rect2d window;
    for (const cv::Point corner :
         {all_.tl(), all_.br(), cv::Point(all_.x, all_.br().y), cv::Point(all_.br().x, all_.y)}) {
      const cv::Vec2d at = forward * cv::Vec3d(corner.x, corner.y, 1);
      const cv::Rect2d around(at[0] - kRounding, at[1] - kRounding, 2 * kRounding, 2 * kRounding);
      window = window.empty() ? around : window | around;
    }
    const cv::Rect2d image(0, 0, now_.width, now_.height);
    return window & image;
  }
  // The instance that stood before what is in cell (x, y) at depth `z_now`, -1 if none did.
  int hider(int x, int y, float z_now) const {
    const int sx = nearest(back_(0, 0) * x + back_(0, 1) * y + back_(0, 2));
    const int sy = nearest(back_(1, 0) * x + back_(1, 1) * y + back_(1, 2));
    if (sx < 0 || sy < 0 || sx >= before_.width || sy >= before_.height) return -1;
    const int who = who_.at<std::int16_t>(sy, sx);
    if (who < 0) return -1;
    const float z = before_.at(sx, sy);
    const float limit = (1 - kMaxDepthJump) * z_now;
    return !measured(z) || z < limit ? who : -1;
  }
  // Gathers the smooth surface of the cell; counts what its border is beside.
  void flood(int start) {
    cells_.clear();
    before_others_ = behind_others_ = 0;
    take(start);
    for (std::size_t next = 0; next < cells_.size(); ++next) {
      if (is_too_large()) return mark_rest(next);
      look_around(cells_[next]);
    }
  }
  // Of a surface that is no thing, lest it is begun again: from the cell at `next` on.
  void mark_rest(std::size_t next) {
    for (; next < cells_.size(); ++next) {
      const float z = depth_.at(cells_[next]);
      for (const int other : depth_.neighbours(cells_[next])) {
        if (state_[static_cast<std::size_t>(other)] == kFacing && step_.joins(depth_.at(other), z))
          take(other);
      }
    }
  }
  void take(int cell) {
    state_[static_cast<std::size_t>(cell)] |= kClosed;
    cells_.push_back(cell);
  }
  void look_around(int cell) {
    const float z = depth_.at(cell);
    for (const int other : depth_.neighbours(cell)) {
      const std::uint8_t state = state_[static_cast<std::size_t>(other)];
      if (state & kClosed) continue;
      const float there = depth_.at(other);
      const bool same = step_.joins(there, z);
      if (same && state == kFacing) {
        take(other);
      } else if (!same && there > z) {
        ++before_others_;
      } else {
        ++behind_others_;
      }
    }
  }
  bool is_too_large() const { return cells_.size() > most_; }
  bool is_thing() {
    if (cells_.size() < kMinRevealed || is_too_large() || before_others_ < behind_others_)
      return false;
    return 2 * count_hidden() >= cells_.size();
  }
  // How many of the cells were hidden, and by whom.
  std::size_t count_hidden() {
    std::size_t hidden = 0;
    hidden_by_.assign(count_, 0);
    for (const int cell : cells_) {
      const int who = hider(cell % depth_.stride - 1, cell / depth_.stride - 1, depth_.at(cell));
      if (who < 0) continue;
      ++hidden;
      ++hidden_by_[static_cast<std::size_t>(who)];
    }
    return hidden;
  }
  RevealedThing thing() const {
    RevealedThing thing;
    thing.mask.cells = cv::Rect(0, 0, now_.width, now_.height);
    thing.mask.in = cv::Mat::zeros(now_.height, now_.width, CV_8UC1);
    for (const int cell : cells_) {
      thing.mask.in.at<std::uint8_t>(cell / depth_.stride - 1, cell % depth_.stride - 1) = 255;
    }
    const auto most = std::max_element(hidden_by_.begin(), hidden_by_.end());
    thing.hider = static_cast<std::size_t>(most - hidden_by_.begin());
    return thing;
  }

  const HalfDepth& before_;
  const HalfDepth& now_;
  cv::Matx23d back_;
  SurfaceStep step_;
  WalledDepth depth_;                // of all of `now_`
  std::vector<std::uint8_t> state_;  // of its cells
  std::size_t most_;                 // cells of a thing
  std::size_t count_;
  cv::Rect all_;  // window of all instances in the older frame
  cv::Mat who_;   // instance of every cell of the older frame, -1 = none
  std::vector<int> cells_;
  std::vector<std::size_t> hidden_by_;
  std::size_t before_others_ = 0, behind_others_ = 0;
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
  WalledDepth depth;  // only of the mask; less than 0 where the search was
  depth.clear(mask.in.size());
  for (int y = 0; y < depth.height; ++y) {
    keep_masked(mask.in.ptr(y), mask.z.ptr<float>(y), depth.width,
                depth.z.data() + depth.cell_of(0, y));
  }
  // Masks with the walls of `depth`, so that a cell has the same place in them.
  const cv::Rect inside(cv::Point(1, 1), mask.in.size());
  cv::Mat rest = cv::Mat::zeros(depth.height + 2, depth.stride, CV_8UC1);
  mask.in.copyTo(rest(inside));
  cv::Mat part;
  const SurfaceStep step(options);
  std::vector<int> cells;
  const auto visit = [&](int cell) {
    depth.z[static_cast<std::size_t>(cell)] *= -1;
    cells.push_back(cell);
  };
  for (int start = depth.begin(); start < depth.end(); ++start) {
    if (!measured(depth.at(start))) continue;
    cells.clear();
    visit(start);
    for (std::size_t next = 0; next < cells.size(); ++next) {
      const float z = -depth.at(cells[next]);
      for (const int other : depth.neighbours(cells[next])) {
        const float there = depth.at(other);
        if (measured(there) && step.joins(there, z)) visit(other);
      }
    }
    if (cells.size() < static_cast<std::size_t>(least)) continue;
    part = cv::Mat::zeros(rest.size(), CV_8UC1);
    for (const int cell : cells) {
      part.data[cell] = 255;
      rest.data[cell] = 0;
    }
    parts.push_back(cut_out(mask, part(inside)));
  }
  CellMask last = cut_out(mask, rest(inside));
  if (!last.cells.empty()) parts.push_back(std::move(last));
  return parts;
}

void surfaces_from_outside(const HalfDepth& now, const CarriedCorners& corners,
                           const DepthRefinementOptions& options, const cv::Rect& where,
                           std::vector<std::uint8_t>& outside) {
  enum : std::uint8_t { kSilent, kIn, kOut };
  outside.assign(now.z.size(), 0);
  // What is farther away is not heard here.
  const cv::Rect heard = cv::Rect(where.x - kVoiceCells, where.y - kVoiceCells,
                                  where.width + 2 * kVoiceCells, where.height + 2 * kVoiceCells) &
                         cv::Rect(0, 0, now.width, now.height);
  if (where.empty() || heard.empty()) return;
  WalledDepth depth;
  depth.cut(now, heard);
  std::vector<std::uint8_t> voice(depth.z.size(), kSilent);
  const SurfaceStep step(options);
  std::vector<int> ring, next;
  for (std::size_t i = 0; i < corners.pairs.size(); ++i) {
    const cv::Point at = cell_at(corners.pairs[i].to, now);
    if (corners.labels[i] == kUnknown || !heard.contains(at)) continue;
    const int cell = depth.cell_of(at.x - heard.x, at.y - heard.y);
    std::uint8_t& state = voice[static_cast<std::size_t>(cell)];
    if (state != kSilent || !measured(depth.at(cell))) continue;
    state = corners.labels[i] == kOutside ? kOut : kIn;
    ring.push_back(cell);
  }
  // From all corners at once, a ring of cells at a time.
  for (int distance = 0; distance < kVoiceCells && !ring.empty(); ++distance) {
    next.clear();
    for (const int cell : ring) {
      const float z = depth.at(cell);
      for (const int other : depth.neighbours(cell)) {
        std::uint8_t& state = voice[static_cast<std::size_t>(other)];
        const float there = depth.at(other);
        if (state != kSilent || !measured(there) || !step.joins(z, there)) continue;
        state = voice[static_cast<std::size_t>(cell)];
        next.push_back(other);
      }
    }
    ring.swap(next);
  }
  for (int y = 0; y < heard.height; ++y) {
    const std::uint8_t* states = voice.data() + depth.cell_of(0, y);
    std::uint8_t* out =
        outside.data() + static_cast<std::ptrdiff_t>(heard.y + y) * now.width + heard.x;
    for (int x = 0; x < heard.width; ++x) out[x] = states[x] == kOut ? 1 : 0;
  }
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
  // The columns that the older frame had.
  const int seen_from = std::clamp(dx, left, right);
  const int seen_to = std::clamp(before.width + dx, seen_from, right);
  for (int y = 0; y < now.height; ++y) {
    const auto row = static_cast<std::ptrdiff_t>(y) * now.width;
    const std::uint8_t* facing = now.facing.data() + row;
    std::uint8_t* out = hidden.data() + row;
    std::copy(facing + left, facing + right, out + left);
    if (y - dy < 0 || y - dy >= before.height) continue;
    const float* seen = before.z.data() + static_cast<std::ptrdiff_t>(y - dy) * before.width - dx;
    for (int x = seen_from; x < seen_to; ++x) {
      const float z = measured(seen[x]) ? seen[x] : 0.0F;
      out[x] = z >= nearer ? 0 : out[x];
    }
  }
}

std::vector<RevealedThing> revealed_things(const HalfDepth& before, const HalfDepth& now,
                                           const std::vector<Instance>& instances,
                                           const CarriedCorners& corners,
                                           const DepthRefinementOptions& options,
                                           const std::vector<std::uint8_t>& taken) {
  cv::Matx23d back;
  if (instances.empty() || !ground_motion(corners, back)) return {};
  return Revealer(before, now, instances, back, options, taken)();
}

}  // namespace dynslam::segmentation
