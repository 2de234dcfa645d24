// Which observations take part, and the structure of the normal equations.
#include <algorithm>
#include <unordered_map>

#include "factors/observations.hpp"
#include "factors/schur_kernels.hpp"
#include "factors/schur_solver.hpp"

namespace dynslam::factors {

void SchurSolver::collect(const BundleProblem& problem) {
  camera_ = problem.camera;
  poses_.assign(problem.T_cam_world.begin(), problem.T_cam_world.end());
  points_.assign(problem.points_world.begin(), problem.points_world.end());
  items_.clear();
  std::vector<int> rows(points_.size(), 0);
  for (const BundleObservation& o : problem.observations)
    if (usable(o, points_[o.point])) rows[o.point] += has_depth(o) ? 3 : 2;
  const auto held = [](Span<const std::uint8_t> flags, std::size_t i) {
    return !flags.empty() && flags[i] != 0;
  };
  // Items in the order of points, by counting; a free point needs three rows to be determined.
  std::vector<std::uint32_t> begin(points_.size() + 1, 0);
  const auto takes_part = [&](const BundleObservation& o) {
    return usable(o, points_[o.point]) &&
           (rows[o.point] >= 3 || held(problem.point_fixed, o.point));
  };
  for (const BundleObservation& o : problem.observations)
    if (takes_part(o)) ++begin[o.point + 1];
  for (std::size_t p = 0; p < points_.size(); ++p) begin[p + 1] += begin[p];
  items_.resize(begin.back());
  std::vector<std::uint8_t> camera_seen(poses_.size(), 0);
  for (std::size_t i = 0; i < problem.observations.size(); ++i) {
    const BundleObservation& o = problem.observations[i];
    if (!takes_part(o)) continue;
    const double certainty = o.inverse_sigma, right_certainty = right_inverse_sigma(o);
    const bool depth = has_depth(o);
    items_[begin[o.point]++] = {o.u,
                                o.v,
                                depth ? o.right_column : 0.0,
                                certainty * certainty,
                                depth ? right_certainty * right_certainty : 0.0,
                                o.weight,
                                o.keyframe,
                                o.point,
                                kNone,
                                static_cast<std::uint32_t>(i)};
    camera_seen[o.keyframe] = 1;
  }
  free_cameras_.clear();
  free_points_.clear();
  camera_index_.assign(poses_.size(), kNone);
  point_index_.assign(points_.size(), kNone);
  for (std::uint32_t k = 0; k < poses_.size(); ++k) {
    if (!camera_seen[k] || held(problem.keyframe_fixed, k)) continue;
    camera_index_[k] = static_cast<std::uint32_t>(free_cameras_.size());
    free_cameras_.push_back(k);
  }
  for (const Item& item : items_) {
    if (held(problem.point_fixed, item.point) || point_index_[item.point] != kNone) continue;
    point_index_[item.point] = static_cast<std::uint32_t>(free_points_.size());
    free_points_.push_back(item.point);
  }
}

// Entries (camera, point) and the camera pairs that share a point.
void SchurSolver::index_blocks() {
  entry_begin_.assign(1, 0);
  entry_camera_.clear();
  entry_point_.clear();
  std::size_t most = 1;
  for (std::size_t i = 0; i < items_.size();) {
    std::size_t end = i;
    while (end < items_.size() && items_[end].point == items_[i].point) ++end;
    const std::uint32_t point = free_point_of(items_[i]);
    if (point != kNone) {
      std::sort(items_.begin() + static_cast<std::ptrdiff_t>(i),
                items_.begin() + static_cast<std::ptrdiff_t>(end),
                [this](const Item& a, const Item& b) {
                  const std::uint32_t ca = camera_of(a), cb = camera_of(b);
                  return ca != cb ? ca < cb : a.original < b.original;
                });
      for (std::size_t k = i; k < end; ++k) {
        const std::uint32_t camera = camera_of(items_[k]);
        if (camera == kNone) continue;
        if (entry_camera_.size() == entry_begin_.back() || entry_camera_.back() != camera) {
          entry_camera_.push_back(camera);
          entry_point_.push_back(point);
        }
        items_[k].entry = static_cast<std::uint32_t>(entry_camera_.size() - 1);
      }
      most = std::max(most, entry_camera_.size() - entry_begin_.back());
      entry_begin_.push_back(static_cast<std::uint32_t>(entry_camera_.size()));
    }
    i = end;
  }

  // Every camera has its diagonal block, in order; then pairs as points bring them up.
  const std::size_t cameras = free_cameras_.size();
  pairs_.clear();
  for (std::uint32_t c = 0; c < cameras; ++c) pairs_.push_back({c, c});
  const bool small = cameras <= 2000;
  std::vector<std::uint32_t> table(small ? cameras * cameras : 0, kNone);
  std::unordered_map<std::uint64_t, std::uint32_t> map;
  const auto block_of = [&](std::uint32_t a, std::uint32_t b) -> std::uint32_t& {
    if (small) return table[a * cameras + b];
    return map.try_emplace(std::uint64_t{a} * cameras + b, kNone).first->second;
  };
  for (std::uint32_t c = 0; c < cameras; ++c) block_of(c, c) = c;
  pair_block_.clear();
  for (std::size_t p = 0; p + 1 < entry_begin_.size(); ++p) {
    for (std::uint32_t a = entry_begin_[p]; a < entry_begin_[p + 1]; ++a) {
      for (std::uint32_t b = a; b < entry_begin_[p + 1]; ++b) {
        std::uint32_t& block = block_of(entry_camera_[a], entry_camera_[b]);
        if (block == kNone) {
          block = static_cast<std::uint32_t>(pairs_.size());
          pairs_.push_back({entry_camera_[a], entry_camera_[b]});
        }
        pair_block_.push_back(block);
      }
    }
  }
  reduced_.analyze(cameras, pairs_);

  block_count_ = pairs_.size();
  const std::size_t sizes[] = {entry_camera_.size() * kernels::kCross, most * kernels::kCross,
                               block_count_ * kernels::kSquare, cameras * kernels::kColumn};
  const std::size_t total = sizes[0] + sizes[1] + sizes[2] + sizes[3] + kernels::kColumn;
  if (total > aligned_size_) {
    aligned_ = hwy::AllocateAligned<double>(total);
    if (!aligned_) throw std::bad_alloc();
    aligned_size_ = total;
  }
  std::fill(aligned_.get(), aligned_.get() + total, 0.0);
  cross_ = aligned_.get();
  scratch_ = cross_ + sizes[0];
  blocks_ = scratch_ + sizes[1];
  rhs_ = blocks_ + sizes[2];
  H_.resize(cameras);
  b_.resize(cameras);
  V_.resize(free_points_.size());
  bp_.resize(free_points_.size());
  dp_.resize(free_points_.size());
  inverse_.resize(9 * free_points_.size());
  gradient_.resize(3 * free_points_.size());
  linear_.resize(items_.size());
}

}  // namespace dynslam::factors
