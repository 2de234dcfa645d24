// The one call of this room: a rule, the host's matches, flags and weights out.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/traits.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching {

namespace detail {

/// The arrays behind a PairsView, and which match of the host's list each pair is.
struct PairsBuffer {
  PairsBuffer(std::size_t capacity, Workspace& workspace)
      : x1(workspace.take<float>(capacity)),
        y1(workspace.take<float>(capacity)),
        x2(workspace.take<float>(capacity)),
        y2(workspace.take<float>(capacity)),
        distance(workspace.take<float>(capacity)),
        rotation(workspace.take<float>(capacity)),
        zoom(workspace.take<float>(capacity)),
        source(workspace.take<std::uint32_t>(capacity)) {}

  void push(const Keypoint& a, const Keypoint& b, float descriptor_distance, std::size_t index) {
    x1[size] = a.x;
    y1[size] = a.y;
    x2[size] = b.x;
    y2[size] = b.y;
    distance[size] = descriptor_distance;
    float turn = b.angle - a.angle;
    if (turn < 0.0F) turn += 360.0F;
    if (!(turn >= 0.0F && turn < 360.0F)) turn = std::numeric_limits<float>::quiet_NaN();
    rotation[size] = turn;
    const bool sized = a.size > 0.0F && b.size > 0.0F && std::isfinite(a.size / b.size);
    zoom[size] = sized ? b.size / a.size : 0.0F;
    has_rotation |= turn == turn;
    has_zoom |= sized;
    has_distance |= descriptor_distance != 0.0F;
    source[size] = static_cast<std::uint32_t>(index);
    ++size;
  }

  PairsView view() const {
    const auto known = [&](Span<float> values, bool has) {
      return has ? Span<const float>(values.data(), size) : Span<const float>();
    };
    return {known(x1, true),
            known(y1, true),
            known(x2, true),
            known(y2, true),
            known(distance, has_distance),
            known(rotation, has_rotation),
            known(zoom, has_zoom)};
  }

  Span<float> x1, y1, x2, y2, distance, rotation, zoom;
  Span<std::uint32_t> source;
  std::size_t size = 0;
  bool has_distance = false, has_rotation = false, has_zoom = false;
};

/// Finite, and so near that squares of differences stay so (false for NaN).
inline bool is_usable(const Keypoint& keypoint) {
  return std::abs(keypoint.x) <= kLargestCoordinate && std::abs(keypoint.y) <= kLargestCoordinate;
}

template <typename Matches, typename Points1, typename Points2>
std::size_t gather(const Matches& matches, const Points1& points1, const Points2& points2,
                   PairsBuffer& buffer) {
  const auto count1 = static_cast<std::int64_t>(keypoint_count(points1));
  const auto count2 = static_cast<std::int64_t>(keypoint_count(points2));
  std::size_t count = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const Match match = match_at(matches, i);
    if (match.query < 0 || match.train < 0) continue;
    require(match.query < count1, "matching::reject", "query index of a match", match.query,
            "an index below the number of points in the first image");
    require(match.train < count2, "matching::reject", "train index of a match", match.train,
            "an index below the number of points in the second image");
    ++count;
    const Keypoint a = keypoint_at(points1, static_cast<std::size_t>(match.query));
    const Keypoint b = keypoint_at(points2, static_cast<std::size_t>(match.train));
    if (is_usable(a) && is_usable(b)) {
      buffer.push(a, b, std::isfinite(match.distance) ? match.distance : 0.0F, i);
    }
  }
  return count;
}

/// Builds its message only if there is something to say: `reject` must not allocate.
inline void check_size(bool fits, const char* function, const char* what, std::size_t size,
                       std::size_t matches) {
  if (!fits) {
    throw_invalid_argument(function, what, size,
                           "the number of matches, " + std::to_string(matches));
  }
}

inline void check_outputs(std::size_t matches, Span<std::uint8_t> keep, Span<float> weight) {
  check_size(keep.size() == matches, "matching::reject", "size of keep", keep.size(), matches);
  check_size(weight.empty() || weight.size() == matches, "matching::reject", "size of weight",
             weight.size(), matches);
}

/// Runs the rule on the gathered pairs and spreads its answer over the host's list.
template <typename Rule>
std::size_t decide(const Rule& rule, const PairsBuffer& pairs, Span<std::uint8_t> keep,
                   Span<float> weight, Workspace& workspace) {
  const auto kept = workspace.take_filled<std::uint8_t>(pairs.size, 0);
  const auto scores = workspace.take_filled<float>(pairs.size, 0.0F);
  rule(pairs.view(), kept, scores, workspace);
  std::fill(keep.begin(), keep.end(), std::uint8_t{0});
  std::fill(weight.begin(), weight.end(), 0.0F);
  std::size_t count = 0;
  for (std::size_t k = 0; k < pairs.size; ++k) {
    keep[pairs.source[k]] = kept[k];
    count += kept[k] != 0;
    if (!weight.empty()) weight[pairs.source[k]] = scores[k];
  }
  return count;
}

}  // namespace detail

/// Decides with `rule` which matches to keep.
///
/// @param rule     any rule of this room, a `Chain` of them, or your own: a callable
///                 `(PairsView, Span<uint8_t> keep, Span<float> weight, Workspace&) const` that
///                 gets `keep` and `weight` filled with 0.
/// @param matches  indexable list of a type that MatchTraits knows: Span or vector of `Match`,
///                 index pairs, ORB-SLAM's `vnMatches12` (vector<int>), cv::DMatch.
/// @param points1  points of the first image, by query index: list of a type that KeypointTraits
///                 knows (cv::KeyPoint, cv::Point2f, `Keypoint`, StridedSpan of points) or the
///                 columns of a 2 x N matrix (Points2f). Pixels; the two images may differ in size.
/// @param points2  points of the second image, by train index.
/// @param keep     out, one flag for each match: 1 kept, 0 rejected (or no match, or NaN or
/// infinite
///                 coordinates). Works as mask of cv::findFundamentalMat and the like.
/// @param weight   out, empty or one number in [0, 1] for each match: how much the rule trusts it;
///                 0 for NaN or infinite coordinates. A rejected match may have a weight above 0.
///                 As an order for PROSAC see `prosac_order`.
///
/// Zero matches give zero; one or two are as the rule says. Throws InvalidArgument if `keep` or
/// `weight` has another size than `matches` or a match points outside the points; outputs are then
/// untouched. Cost: O(N) here plus the rule's; allocates only if the workspace is too small.
/// Reentrant with one workspace for each thread.
template <typename Rule, typename Matches, typename Points1, typename Points2>
Rejection reject(const Rule& rule, const Matches& matches, const Points1& points1,
                 const Points2& points2, Span<std::uint8_t> keep, Span<float> weight,
                 Workspace& workspace) {
  detail::check_outputs(matches.size(), keep, weight);
  workspace.reserve(matches.size());
  const Workspace::Frame frame(workspace);
  detail::PairsBuffer pairs(matches.size(), workspace);
  Rejection result;
  result.matches = detail::gather(matches, points1, points2, pairs);
  result.usable = pairs.size;
  result.kept = detail::decide(rule, pairs, keep, weight, workspace);
  return result;
}

/// As `reject`, for points that are matched already: point i of the first list with point i of the
/// second. Throws InvalidArgument also if the lists differ in length.
template <typename Rule, typename Points1, typename Points2>
Rejection reject_pairs(const Rule& rule, const Points1& points1, const Points2& points2,
                       Span<std::uint8_t> keep, Span<float> weight, Workspace& workspace) {
  const std::size_t count = detail::keypoint_count(points1);
  detail::check_size(detail::keypoint_count(points2) == count, "matching::reject_pairs",
                     "size of points2", detail::keypoint_count(points2), count);
  detail::check_outputs(count, keep, weight);
  workspace.reserve(count);
  const Workspace::Frame frame(workspace);
  detail::PairsBuffer pairs(count, workspace);
  for (std::size_t i = 0; i < count; ++i) {
    const Keypoint a = detail::keypoint_at(points1, i);
    const Keypoint b = detail::keypoint_at(points2, i);
    if (detail::is_usable(a) && detail::is_usable(b)) pairs.push(a, b, 0.0F, i);
  }
  Rejection result;
  result.matches = count;
  result.usable = pairs.size;
  result.kept = detail::decide(rule, pairs, keep, weight, workspace);
  return result;
}

/// Removes the rejected matches from the host's own list, keeping the order. Throws
/// InvalidArgument if `keep` has another size. O(N).
template <typename M>
void erase_rejected(std::vector<M>& matches, Span<const std::uint8_t> keep) {
  require(keep.size() == matches.size(), "matching::erase_rejected", "size of keep", keep.size(),
          matches.size());
  std::size_t next = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    if (keep[i] != 0) matches[next++] = matches[i];
  }
  matches.resize(next);
}

/// Writes -1 over the rejected entries of ORB-SLAM's `vnMatches12` and returns how many matches
/// remain (what SearchForInitialization and its kin return). Throws InvalidArgument if `keep` has
/// another size. O(N).
inline int clear_rejected(std::vector<int>& matches12, Span<const std::uint8_t> keep) {
  require(keep.size() == matches12.size(), "matching::clear_rejected", "size of keep", keep.size(),
          matches12.size());
  int remaining = 0;
  for (std::size_t i = 0; i < matches12.size(); ++i) {
    if (keep[i] == 0) matches12[i] = -1;
    if (matches12[i] >= 0) ++remaining;
  }
  return remaining;
}

/// Positions of the matches, most trusted first (ties in their old order), as PROSAC wants them.
/// Throws InvalidArgument if `order` has another size than `weight`. O(N log N).
inline void prosac_order(Span<const float> weight, Span<std::int32_t> order) {
  require(order.size() == weight.size(), "matching::prosac_order", "size of order", order.size(),
          weight.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    const float wa = weight[static_cast<std::size_t>(a)];
    const float wb = weight[static_cast<std::size_t>(b)];
    return wa != wb ? wa > wb : a < b;
  });
}

}  // namespace dynslam::matching
