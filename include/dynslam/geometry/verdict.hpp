// What the tests of this room answer, and the noise that they reckon with.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "dynslam/core/errors.hpp"

namespace dynslam::geometry {

/// Answer about one feature, cell or map point. "Don't know" is an answer.
enum class Verdict : std::uint8_t { kUnknown, kStatic, kDynamic };

/// Why. The first group goes with kUnknown, then kStatic, then kDynamic.
enum class Reason : std::uint8_t {
  kNoReference,        ///< in no reference's view, or matched to none
  kNotFinite,          ///< NaN pixel or pose
  kNoBaseline,         ///< too little parallax for an epipolar plane, and no depth
  kNoDepth,            ///< depth missing now or in every reference
  kDepthEdge,          ///< at a depth discontinuity or hole, now or in every reference
  kOccluded,           ///< hidden in every reference, or something static stands in front now
  kUndecided,          ///< tests were made and outweigh one another
  kConsistent,         ///< passed all tests that could be made
  kRemembered,         ///< decided by memory or neighbourhood, not by a test of its own
  kEpipolarViolated,   ///< the ray leaves the epipolar plane
  kDepthViolated,      ///< depth differs from the expected (motion along the epipolar line)
  kTransferViolated,   ///< moved along the epipolar line at the expected depth
  kFreeSpaceViolated,  ///< a reference looked through where there is a surface now
};

/// Short English name, for logs and tables.
constexpr const char* to_string(Reason reason) {
  constexpr const char* kNames[] = {"no reference",       "not finite",     "no baseline",
                                    "no depth",           "depth edge",     "occluded",
                                    "undecided",          "consistent",     "remembered",
                                    "epipolar violated",  "depth violated", "transfer violated",
                                    "free space violated"};
  return kNames[static_cast<int>(reason)];
}

constexpr const char* to_string(Verdict verdict) {
  constexpr const char* kNames[] = {"unknown", "static", "dynamic"};
  return kNames[static_cast<int>(verdict)];
}

/// Answer about one feature.
struct FeatureVerdict {
  Verdict verdict = Verdict::kUnknown;
  Reason reason = Reason::kNoReference;
  std::uint8_t dynamic_votes = 0;  ///< references that say dynamic
  std::uint8_t static_votes = 0;   ///< references that say static
  float delta = 0.0F;     ///< score of the paper, alpha |c| + beta |dz|, mean over the references
                          ///< that voted (radians for epipolar votes, metres for depth votes)
  float log_odds = 0.0F;  ///< log p(dynamic)/p(static) from this frame's tests; 0 = no idea

  /// p(static) in [0, 1]: the m_geo of the weighted reprojection factor. 0.5 = no idea.
  float staticness() const { return 1.0F / (1.0F + std::exp(log_odds)); }
};

/// Standard deviation of a structured-light camera's depth: a + b (z - c)^2 metres.
///
/// Defaults: Nguyen, Izadi, Lovell, 3DIMPVT 2012 (axial noise of the Kinect). For stereo,
/// sigma = z^2 / bf * 0.5 pixel: a = 0, c = 0, b = 0.5 / bf.
struct DepthNoise {
  double a = 0.0012;  ///< metres, >= 0
  double b = 0.0019;  ///< 1/metres, >= 0
  double c = 0.4;     ///< metres, finite

  double sigma(double z) const { return a + b * (z - c) * (z - c); }

  void validate() const {
    require(std::isfinite(a) && a >= 0.0, "DepthNoise", "a", a, "a finite number >= 0");
    require(std::isfinite(b) && b >= 0.0, "DepthNoise", "b", b, "a finite number >= 0");
    require(std::isfinite(c), "DepthNoise", "c", c, "a finite number");
    require(a + b > 0.0, "DepthNoise", "a + b", a + b, "a positive number (some noise)");
  }
};

/// Uncertainty of the pose of the current frame relative to a reference, one sigma an axis.
///
/// Default: what feature tracking indoors reaches (7-Scenes, TUM RGB-D), engineering.
struct PoseNoise {
  double rotation = 0.002;     ///< radians, >= 0
  double translation = 0.005;  ///< metres, >= 0

  void validate() const {
    require(std::isfinite(rotation) && rotation >= 0.0, "PoseNoise", "rotation", rotation,
            "a finite number >= 0");
    require(std::isfinite(translation) && translation >= 0.0, "PoseNoise", "translation",
            translation, "a finite number >= 0");
  }
};

/// Whether a depth was measured: finite and positive.
inline bool has_depth(float z) { return z > 0.0F && std::isfinite(z); }

}  // namespace dynslam::geometry
