// Implementation of static_memory.hpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include "dynslam/core/errors.hpp"
#include "dynslam/geometry/static_memory.hpp"

namespace dynslam::geometry {

inline void StaticMemoryOptions::validate() const {
  const char* me = "StaticMemoryOptions";
  require(std::isfinite(half_life) && half_life > 0.0, me, "half_life", half_life,
          "a positive number of seconds");
  require(std::isfinite(max_dynamic) && max_dynamic > 0.0, me, "max_dynamic", max_dynamic,
          "a positive number");
  require(std::isfinite(max_static) && max_static > 0.0, me, "max_static", max_static,
          "a positive number");
  require(std::isfinite(decision) && decision >= 0.0, me, "decision", decision,
          "a finite number >= 0");
}

inline void CellMemoryOptions::validate() const {
  const char* me = "CellMemoryOptions";
  require(retention >= 0.0 && retention < 1.0, me, "retention", retention, "a number in [0, 1)");
  require(std::isfinite(max_dynamic) && max_dynamic > 0.0, me, "max_dynamic", max_dynamic,
          "a positive number");
  require(std::isfinite(max_static) && max_static > 0.0, me, "max_static", max_static,
          "a positive number");
  require(std::isfinite(max_speed) && max_speed >= 0.0, me, "max_speed", max_speed,
          "a finite number >= 0");
}

namespace detail {

inline Verdict decide(double log_odds, double decision) {
  if (log_odds > decision) return Verdict::kDynamic;
  return log_odds < -decision ? Verdict::kStatic : Verdict::kUnknown;
}

}  // namespace detail

inline StaticMemory::StaticMemory(const StaticMemoryOptions& options) : options_(options) {
  options.validate();
}

inline double StaticMemory::decayed(const Entry& entry, double time) const {
  const double passed = time - entry.time;
  return passed > 0.0 ? entry.log_odds * std::exp2(-passed / options_.half_life) : entry.log_odds;
}

inline double StaticMemory::update(std::uint64_t id, double evidence, double time) {
  const auto [it, is_new] = entries_.try_emplace(id, Entry{0.0F, time});
  Entry& entry = it->second;
  const double sum = decayed(entry, time) + (std::isnan(evidence) ? 0.0 : evidence);
  entry.log_odds = static_cast<float>(std::clamp(sum, -options_.max_static, options_.max_dynamic));
  if (is_new || time > entry.time) entry.time = time;
  return entry.log_odds;
}

inline void StaticMemory::update(Span<const std::uint64_t> ids, double time,
                                 Span<FeatureVerdict> verdicts) {
  require(ids.size() == verdicts.size(), "StaticMemory::update", "ids.size", ids.size(),
          std::to_string(verdicts.size()) + ", the number of verdicts");
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (ids[i] == kNoId) continue;
    FeatureVerdict& v = verdicts[i];
    v.log_odds = static_cast<float>(update(ids[i], v.log_odds, time));
    const Verdict remembered = detail::decide(v.log_odds, options_.decision);
    if (remembered == v.verdict) continue;
    v.verdict = remembered;
    v.reason = remembered == Verdict::kUnknown ? Reason::kUndecided : Reason::kRemembered;
  }
}

inline double StaticMemory::log_odds(std::uint64_t id, double time) const {
  const auto it = entries_.find(id);
  return it == entries_.end() ? 0.0 : decayed(it->second, time);
}

inline Verdict StaticMemory::verdict(std::uint64_t id, double time) const {
  return detail::decide(log_odds(id, time), options_.decision);
}

inline void StaticMemory::erase(std::uint64_t id) { entries_.erase(id); }

inline void StaticMemory::erase_older_than(double time) {
  for (auto it = entries_.begin(); it != entries_.end();) {
    it = it->second.time < time ? entries_.erase(it) : std::next(it);
  }
}

inline void StaticMemory::clear() { entries_.clear(); }

inline std::size_t StaticMemory::size() const { return entries_.size(); }

inline CellMemory::CellMemory(const CellMemoryOptions& options) : options_(options) {
  options.validate();
}

inline void CellMemory::clear() { filled_ = false; }

/// Projects last frame's cells into this frame; a cell takes the strongest log-odds that lands on
/// it at its own depth, within what a mover can have changed.
inline void CellMemory::carry(const PinholeCamera& camera, const RigidTransform& T_cur_last,
                              double passed, const DepthEvidence& now) {
  carried_.assign(now.depth.size(), 0.0F);
  const double half = now.stride / 2;
  const float reach = static_cast<float>(options_.max_speed * passed);
  for (int y = 0; y < last_.height; ++y) {
    for (int x = 0; x < last_.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * last_.width + x;
      if (last_.depth[i] <= 0.0F || last_.log_odds[i] == 0.0F) continue;
      const Eigen::Vector2d p(x * now.stride + half, y * now.stride + half);
      const Eigen::Vector3d X = T_cur_last * camera.unproject(p, last_.depth[i]);
      if (!PinholeCamera::in_domain(X)) continue;
      const Eigen::Vector2d q = camera.project(X);
      if (!camera.contains(q)) continue;
      const int cx = static_cast<int>(q.x()) / now.stride,
                cy = static_cast<int>(q.y()) / now.stride;
      const std::size_t k = static_cast<std::size_t>(cy) * now.width + cx;
      const float z = static_cast<float>(X.z());
      // A mover may have changed its depth; what is static may not.
      const float tolerance = 0.02F * z + (last_.log_odds[i] > 0.0F ? 0.02F + reach : 0.02F);
      if (now.depth[k] <= 0.0F || std::abs(now.depth[k] - z) > tolerance) continue;
      if (std::abs(last_.log_odds[i]) > std::abs(carried_[k])) carried_[k] = last_.log_odds[i];
    }
  }
}

inline void CellMemory::update(const PinholeCamera& camera, const RigidTransform& T_world_cam,
                               double time, double decision, DepthEvidence& evidence) {
  camera.validate();
  const char* me = "CellMemory::update";
  require(T_world_cam.all_finite(), me, "T_world_cam", "a pose with NaN or infinity",
          "a finite pose");
  require(evidence.stride >= 1 &&
              evidence.width == (camera.width + evidence.stride - 1) / evidence.stride &&
              evidence.height == (camera.height + evidence.stride - 1) / evidence.stride,
          me, "evidence", "cells of another camera", "cells of this camera");
  if (filled_ && last_.stride == evidence.stride && last_.width == evidence.width &&
      last_.height == evidence.height && time >= time_) {
    carry(camera, T_world_cam.inverse() * T_world_cam_, time - time_, evidence);
    const float keep = static_cast<float>(options_.retention);
    for (std::size_t i = 0; i < carried_.size(); ++i) {
      evidence.log_odds[i] = std::clamp(evidence.log_odds[i] + keep * carried_[i],
                                        static_cast<float>(-options_.max_static),
                                        static_cast<float>(options_.max_dynamic));
      evidence.verdict[i] = detail::decide(evidence.log_odds[i], decision);
    }
    detail::count_verdicts(evidence);
  }
  last_.stride = evidence.stride;
  last_.width = evidence.width;
  last_.height = evidence.height;
  last_.depth = evidence.depth;
  last_.log_odds = evidence.log_odds;
  T_world_cam_ = T_world_cam;
  time_ = time;
  filled_ = true;
}

}  // namespace dynslam::geometry
