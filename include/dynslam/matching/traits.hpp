// How the host's matches and key points are read.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>

#include <Eigen/Core>

#include "dynslam/core/match.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::matching {

/// A key point as the rules know it.
struct Keypoint {
  float x = 0.0F;                                         ///< pixels
  float y = 0.0F;                                         ///< pixels
  float angle = std::numeric_limits<float>::quiet_NaN();  ///< degrees, NaN if not known
  float size = 0.0F;                                      ///< diameter in pixels, 0 if not known
};

/// Customization point: how one element of a list of matches is read.
///
/// Specialize it for your own type with `static Match get(const M& m, std::size_t i)`, where `i` is
/// the position in the list. A negative `query` or `train` in the result means that this element is
/// no match. Here: `dynslam::Match`, pairs of indices, and integers (ORB-SLAM's `vnMatches12`: the
/// position is the index in the first frame, the value the index in the second, or -1); for
/// cv::DMatch include "dynslam/matching/opencv.hpp".
template <typename M, typename Enable = void>
struct MatchTraits;

template <>
struct MatchTraits<Match> {
  static Match get(const Match& match, std::size_t) { return match; }
};

template <typename Integer>
struct MatchTraits<Integer, std::enable_if_t<std::is_integral_v<Integer>>> {
  static_assert(std::is_signed_v<Integer>, "no match is a negative number");
  static Match get(Integer train, std::size_t i) {
    return {static_cast<std::int32_t>(i), static_cast<std::int32_t>(train), 0.0F};
  }
};

template <typename A, typename B>
struct MatchTraits<std::pair<A, B>> {
  static Match get(const std::pair<A, B>& match, std::size_t) {
    return {static_cast<std::int32_t>(match.first), static_cast<std::int32_t>(match.second), 0.0F};
  }
};

template <typename Integer>
struct MatchTraits<std::array<Integer, 2>, std::enable_if_t<std::is_integral_v<Integer>>> {
  static Match get(const std::array<Integer, 2>& match, std::size_t) {
    return {static_cast<std::int32_t>(match[0]), static_cast<std::int32_t>(match[1]), 0.0F};
  }
};

/// Customization point: how one key point is read.
///
/// Specialize it for your own type with `static Keypoint get(const K& k)`. Here: `Keypoint`, every
/// struct with members `x` and `y` (cv::Point2f), and Eigen's 2-vectors; for cv::KeyPoint include
/// "dynslam/matching/opencv.hpp".
template <typename K, typename Enable = void>
struct KeypointTraits;

template <>
struct KeypointTraits<Keypoint> {
  static const Keypoint& get(const Keypoint& keypoint) { return keypoint; }
};

namespace detail {

template <typename P>
using HasXY = std::enable_if_t<std::is_arithmetic_v<std::decay_t<decltype(std::declval<P>().x)>> &&
                               std::is_arithmetic_v<std::decay_t<decltype(std::declval<P>().y)>>>;

template <typename P>
inline constexpr bool kIsEigen = std::is_base_of_v<Eigen::MatrixBase<P>, P>;

}  // namespace detail

template <typename P>
struct KeypointTraits<P, detail::HasXY<P>> {
  static Keypoint get(const P& point) {
    Keypoint keypoint;
    keypoint.x = static_cast<float>(point.x);
    keypoint.y = static_cast<float>(point.y);
    return keypoint;
  }
};

template <typename P>
struct KeypointTraits<P, std::enable_if_t<detail::kIsEigen<P>>> {
  static_assert(P::SizeAtCompileTime == 2, "an image point is a 2-vector");
  static Keypoint get(const P& point) {
    Keypoint keypoint;
    keypoint.x = static_cast<float>(point[0]);
    keypoint.y = static_cast<float>(point[1]);
    return keypoint;
  }
};

namespace detail {

/// Number of key points in a list (size()) or in the columns of a 2 x N matrix.
template <typename Set>
std::size_t keypoint_count(const Set& set) {
  if constexpr (kIsEigen<Set>) {
    static_assert(Set::RowsAtCompileTime == 2, "points are the columns of a 2 x N matrix");
    return static_cast<std::size_t>(set.cols());
  } else {
    return set.size();
  }
}

template <typename Set>
Keypoint keypoint_at(const Set& set, std::size_t i) {
  if constexpr (kIsEigen<Set>) {
    Keypoint keypoint;
    keypoint.x = static_cast<float>(set(0, static_cast<Eigen::Index>(i)));
    keypoint.y = static_cast<float>(set(1, static_cast<Eigen::Index>(i)));
    return keypoint;
  } else {
    using Element = std::decay_t<decltype(set[i])>;
    return KeypointTraits<Element>::get(set[i]);
  }
}

template <typename List>
Match match_at(const List& list, std::size_t i) {
  using Element = std::decay_t<decltype(list[i])>;
  return MatchTraits<Element>::get(list[i], i);
}

}  // namespace detail

}  // namespace dynslam::matching
