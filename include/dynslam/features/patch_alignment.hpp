// Where the patch about a key point lies in another image, to a tenth of a pixel.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include <Eigen/Core>

#include "dynslam/core/image_view.hpp"

namespace dynslam::features {

/// Grey values about a place on one level of a pyramid.
struct Patch {
  static constexpr int kRadius = 8;
  static constexpr int kSide = 2 * kRadius + 1;
  std::array<std::uint8_t, kSide * kSide> pixels{};  ///< row by row
  /// The place minus the centre of the middle pixel, pixels of the level, [-1/2, 1/2].
  Eigen::Vector2f offset = Eigen::Vector2f::Zero();
};

/// Cuts the patch about `at` (pixels of the level, centres at integers). Nothing if it does not lie
/// inside as a whole, or `at` is not finite.
std::optional<Patch> cut_patch(GrayView level, const Eigen::Vector2f& at);

struct PatchAlignmentOptions {
  /// Pixels of the level that the place may be off the start, > 0.
  float max_shift = 1.0F;
  /// Most that may differ, as a share of the patch's variance, once brightness and contrast are
  /// fitted, [0, 1].
  float max_unlike = 0.5F;
  /// Grey levels a pixel that the patch must have in every direction (root mean square), >= 0:
  /// along an edge there is nothing to hold on to.
  float min_gradient = 2.0F;
  int max_iterations = 6;  ///< >= 1
};

enum class PatchStatus : std::uint8_t {
  kAligned,
  kOutside,    ///< the start is not finite, or the window leaves the level
  kDistorted,  ///< the warped window leaves the patch: too great a change of view
  kFlat,       ///< too little gradient
  kAstray,     ///< farther off than allowed, or iterations came to no end
  kUnlike      ///< what is there does not look like the patch
};

struct PatchAlignment {
  PatchStatus status = PatchStatus::kOutside;
  Eigen::Vector2f at = Eigen::Vector2f::Zero();  ///< pixels of the level; of use if ok()
  /// Standard deviation of a coordinate of the place, as far as what is left of the difference
  /// tells, pixels of the level; of use if ok(). A quarter low, whatever the noise is:
  /// interpolation smooths what is compared.
  float sigma = 0.0F;
  bool ok() const { return status == PatchStatus::kAligned; }
};

/// Finds the place on `level` near `start` (its pixels) that shows what the patch shows at its own,
/// in a window of 8 x 8 pixels of the level.
///
/// `A_patch_level` says how a step on the level, in its pixels, looks on the patch, in those of the
/// level that it was cut from: the identity for the same view, scale ratio and rotation for another
/// one. Up to about 1.2 pixels a pixel fit into a patch with any rotation.
///
/// Gauss-Newton on the inverse composition: the patch is warped once, its gradients serve every
/// step. Brightness and contrast are fitted along. Sums are of 32-bit floats in an order that
/// depends on the machine's vectors: places agree to a thousandth of a pixel among them.
///
/// O(1), 0.2 to 0.4 us; allocates nothing; thread-safe.
/// Source: Baker, Matthews, "Lucas-Kanade 20 years on", IJCV 2004 (inverse compositional); Forster,
/// Pizzoli, Scaramuzza, "SVO", ICRA 2014 (feature alignment against the view of a keyframe).
PatchAlignment align_patch(const Patch& patch, const Eigen::Matrix2f& A_patch_level, GrayView level,
                           const Eigen::Vector2f& start, const PatchAlignmentOptions& options = {});

}  // namespace dynslam::features
