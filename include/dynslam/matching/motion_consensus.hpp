// Our default rule: neighbours that move alike, then the epipolar geometry they agree on.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/matching/detail/epipolar_fit.hpp"
#include "dynslam/matching/detail/epipolar_search.hpp"
#include "dynslam/matching/detail/local_support.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching {

/// Options of `MotionConsensus`. Lengths are pixels of the images as matched.
struct MotionConsensusOptions {
  float epipolar_tolerance = 2.0F;  ///< px: distance from the epipolar line, in either image, up to
                                    ///< which a match agrees with the camera's motion. Engineering:
                                    ///< about two sigma of ORB's localization.
  float support_tolerance = 3.0F;   ///< px: difference of displacement always allowed between
                                    ///< neighbours that move alike. Engineering.
  float support_slope = 0.2F;    ///< and this times their distance: what remains of roll, zoom and
                                 ///< perspective (0.2 is 11 degrees). Engineering.
  float independence = 3.0F;     ///< px: neighbours nearer than this are no evidence of their own;
                                 ///< the same corner found in two octaves fails twice.
  float minimum_support = 1.5F;  ///< neighbours that must move alike before a match counts as
                                 ///< supported, above 0. Engineering: chance gives about 0.1.
  int maximum_hypotheses = 40;   ///< epipolar geometries tried at most, 0 to 1000; 0 leaves the
                                 ///< decision to support alone. Fewer are tried when most agree.
  std::uint32_t seed = 1;        ///< of the sampling; the same input and seed give the same answer.

  /// Throws InvalidArgument naming the member.
  void validate() const {
    const auto positive = [](const char* name, float value) {
      require(value > 0.0F && value < 1e6F, "MotionConsensusOptions", name, value,
              "above 0 and below a million");
    };
    positive("epipolar_tolerance", epipolar_tolerance);
    positive("support_tolerance", support_tolerance);
    positive("independence", independence);
    positive("minimum_support", minimum_support);
    require(support_slope >= 0.0F && support_slope < 1.0F, "MotionConsensusOptions",
            "support_slope", support_slope, "at least 0 and below 1");
    require(maximum_hypotheses >= 0 && maximum_hypotheses <= 1000, "MotionConsensusOptions",
            "maximum_hypotheses", maximum_hypotheses, "0 to 1000");
  }
};

/// Our default: keeps what neighbours confirm or the camera's motion explains, and what moves on
/// its own.
///
/// 1. Support. A match is supported by the neighbours in the first image (3 x 3 cells of a grid
/// with
///    three matches a cell) whose displacement equals its own up to `support_tolerance`, and to
///    `support_slope` times their distance in quadrature, after the dominant roll and zoom have
///    been taken out. Wrong matches find such neighbours by chance alone.
/// 2. Geometry. Among the supported matches (few are wrong) eight-point samples, spread over the
///    image, give fundamental matrices; the best three by truncated Sampson cost are refined by
///    Gauss-Newton with a Geman-McClure kernel, the best of these is kept.
/// 3. Decision, r being the distance from the epipolar line (the larger of both images), T its
///    tolerance (a quarter more for supported matches, which are likely right), s the support, s0
///    its minimum:
///    - r < T: kept, supported or not. Isolated true matches come back here.
///    - s > s0 and the supporters' mean signed distance m is beyond T with |r - m| < T: kept; all
///    of
///      them are off alike, so something moves (or F is wrong here).
///    - s > 2 s0 and r > 4 T: kept; chance does not give that much support, so it is a mover.
///    - else rejected: chance matches, and true ones too badly located to be of use.
/// Pure rotation and planes leave F ambiguous, but every F of the family explains all true matches.
///
/// Weight: s / (s + s0) (at least 0.2) over 1 + (r/T)^2, halved for a mover: the camera's own
/// motion comes first in PROSAC order. With fewer than eight supported matches, or
/// `maximum_hypotheses` 0, support decides alone: kept if s > s0, weight s / (s + s0). So one or
/// two matches are always rejected with weight 0 (nothing confirms them), and so are matches that
/// all lie on one point.
///
/// Deterministic. Cost O(N): 0.07 ms for 500 matches, 0.2 ms for 2000. No allocation with a warm
/// workspace. Source: our own; the ideas are in docs/decisions with the comparison.
class MotionConsensus {
 public:
  MotionConsensus() = default;

  /// Throws InvalidArgument by name of the option.
  explicit MotionConsensus(const MotionConsensusOptions& options) : options_(options) {
    options_.validate();
  }

  const MotionConsensusOptions& options() const { return options_; }

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    if (pairs.size() < 3) return;
    const detail::SupportTolerance tolerance{options_.support_tolerance, options_.support_slope,
                                             options_.independence};
    detail::Similarity similarity = detail::dominant_similarity(pairs);
    if (similarity.doubtful) {
      const Workspace::Frame scratch(workspace);
      const detail::LocalSupport turned(pairs, tolerance, similarity, workspace);
      const detail::LocalSupport straight(pairs, tolerance, {}, workspace);
      const float minimum = options_.minimum_support;
      if (straight.count_above(minimum) >= turned.count_above(minimum)) similarity = {};
    }
    const detail::LocalSupport local(pairs, tolerance, similarity, workspace);
    Frame frame{pairs, local, supported_matches(local, workspace), {}, 0.0F};
    detail::Matrix3d f = detail::Matrix3d::Zero();
    if (options_.maximum_hypotheses > 0 && frame.supported.size() >= detail::kSampleSize) {
      normalize(frame);
      if (find_geometry(frame, workspace, f)) {
        decide_by_geometry(frame, f, keep, weight, workspace);
        return;
      }
    }
    decide_by_support(local, keep, weight);
  }

 private:
  static constexpr std::size_t kSearchPoints = 200;  // that hypotheses are scored on
  static constexpr std::size_t kRefinePoints = 600;  // that the final model is fitted to
  static constexpr float kSupportedBand = 1.25F;

  struct Frame {
    const PairsView& pairs;
    const detail::LocalSupport& local;
    Span<const std::uint32_t> supported;  // in grid order
    float centre[4];                      // of the supported points: x1, y1, x2, y2
    float scale;                          // fit coordinates per pixel
  };

  bool is_supported(float support) const { return support > options_.minimum_support; }

  Span<const std::uint32_t> supported_matches(const detail::LocalSupport& local,
                                              Workspace& workspace) const {
    const auto support = local.support();
    const auto result = workspace.take<std::uint32_t>(support.size());
    std::size_t count = 0;
    for (std::size_t k = 0; k < support.size(); ++k) {
      result[count] = static_cast<std::uint32_t>(k);
      count += is_supported(support[k]);
    }
    return {result.data(), count};
  }

  /// Centre of (at most `kSearchPoints` of) the supported points and their mean absolute
  /// coordinate.
  static void normalize(Frame& frame) {
    const Span<const float> coordinates[4] = {frame.pairs.x1, frame.pairs.y1, frame.pairs.x2,
                                              frame.pairs.y2};
    const auto source = frame.local.source();
    const std::size_t step = stride(frame, kSearchPoints);
    double spread = 0.0;
    double count = 0.0;
    for (int c = 0; c < 4; ++c) {
      double sum = 0.0;
      count = 0.0;
      for (std::size_t s = 0; s < frame.supported.size(); s += step) {
        sum += static_cast<double>(coordinates[c][source[frame.supported[s]]]);
        count += 1.0;
      }
      const float centre = static_cast<float>(sum / count);
      for (std::size_t s = 0; s < frame.supported.size(); s += step) {
        spread +=
            static_cast<double>(std::abs(coordinates[c][source[frame.supported[s]]] - centre));
      }
      frame.centre[c] = centre;
    }
    frame.scale = static_cast<float>(4.0 * count / std::max(spread, 1e-3));
  }

  /// Step that leaves at most `capacity` of the supported matches.
  static std::size_t stride(const Frame& frame, std::size_t capacity) {
    return (frame.supported.size() + capacity - 1) / capacity;
  }

  static void push(const Frame& frame, std::size_t k, float weight, detail::FitPoints& points) {
    const std::size_t i = frame.local.source()[k];
    points.push((frame.pairs.x1[i] - frame.centre[0]) * frame.scale,
                (frame.pairs.y1[i] - frame.centre[1]) * frame.scale,
                (frame.pairs.x2[i] - frame.centre[2]) * frame.scale,
                (frame.pairs.y2[i] - frame.centre[3]) * frame.scale, weight);
  }

  /// Every n-th supported match, at most `capacity`, in grid order; more support, more weight.
  detail::FitPoints collect(const Frame& frame, std::size_t capacity, Workspace& workspace) const {
    detail::FitPoints points(std::min(capacity, frame.supported.size()), workspace);
    const auto support = frame.local.support();
    const std::size_t step = stride(frame, capacity);
    for (std::size_t s = 0; s < frame.supported.size(); s += step) {
      const std::size_t k = frame.supported[s];
      push(frame, k, std::min(1.0F, 0.5F * support[k] / options_.minimum_support), points);
    }
    points.pad();
    return points;
  }

  bool find_geometry(const Frame& frame, Workspace& workspace, detail::Matrix3d& f) const {
    const float limit = 1.5F * options_.epipolar_tolerance * frame.scale;
    const detail::FitPoints points = collect(frame, kSearchPoints, workspace);
    const detail::SearchOptions search{limit, options_.maximum_hypotheses, options_.seed};
    if (!detail::search_geometry(points, search, f)) return false;
    const detail::FitPoints more = collect(frame, kRefinePoints, workspace);
    for (int i = 0; i < 4; ++i) detail::refine(f, more, limit);
    return true;
  }

  /// Signed distance from the epipolar line in pixels, the larger of both images, in grid order and
  /// padded.
  static Span<float> epipolar_distances(const Frame& frame, const detail::Matrix3d& f,
                                        Workspace& workspace) {
    const std::size_t n = frame.pairs.size();
    detail::FitPoints points(n, workspace);
    for (std::size_t k = 0; k < n; ++k) push(frame, k, 0.0F, points);
    points.pad();
    const auto distance = workspace.take_filled<float>(n + 8, 0.0F);
    const detail::FloatF values(f);
    for (std::size_t k = 0; k < n; k += 4) {
      const detail::Epipolar4 at(values.v, points, k);
      const detail::Float4 gradient = (at.g1.min(at.g2) + 1e-20F).sqrt();
      detail::store(at.e / (gradient * frame.scale), distance.data() + k);
    }
    for (std::size_t k = n; k < n + 8; ++k) distance[k] = 0.0F;
    return distance;
  }

  void decide_by_geometry(const Frame& frame, const detail::Matrix3d& f, Span<std::uint8_t> keep,
                          Span<float> weight, Workspace& workspace) const {
    const auto distance = epipolar_distances(frame, f, workspace);
    const auto support = frame.local.support();
    const auto source = frame.local.source();
    const float tolerance = options_.epipolar_tolerance;
    const float minimum = options_.minimum_support;
    for (std::size_t k = 0; k < support.size(); ++k) {
      const float r = std::abs(distance[k]);
      const bool supported = is_supported(support[k]);
      const float band = supported ? kSupportedBand * tolerance : tolerance;
      const float trust = std::max(0.2F, support[k] / (support[k] + minimum));
      bool kept = r < band;
      float part = 1.0F / (1.0F + (r / tolerance) * (r / tolerance));
      if (!kept && supported) {
        const bool far = r > 4.0F * tolerance;
        if (far && support[k] > 2.0F * minimum) {
          kept = true;
          part = 0.5F;
        } else {
          const float mean = frame.local.mean_over_supporters(k, distance);
          const float offset = distance[k] - mean;
          kept = std::abs(mean) > tolerance && std::abs(offset) < tolerance;
          if (kept) part = 0.5F / (1.0F + (offset / tolerance) * (offset / tolerance));
        }
      }
      keep[source[k]] = kept ? 1 : 0;
      weight[source[k]] = trust * part;
    }
  }

  void decide_by_support(const detail::LocalSupport& local, Span<std::uint8_t> keep,
                         Span<float> weight) const {
    const auto support = local.support();
    for (std::size_t k = 0; k < support.size(); ++k) {
      keep[local.source()[k]] = is_supported(support[k]) ? 1 : 0;
      weight[local.source()[k]] = support[k] / (support[k] + options_.minimum_support);
    }
  }

  MotionConsensusOptions options_;
};

/// The rule to take when none is asked for.
using DefaultRule = MotionConsensus;

}  // namespace dynslam::matching
