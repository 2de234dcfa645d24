// The loops of patch_alignment.cpp over a window; dispatched at run time to the best instruction
// set.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::features::detail {

constexpr int kWindow = 8;            ///< pixels a side
constexpr int kRimmed = kWindow + 2;  ///< with a pixel around it for the slopes

/// A patch as a level should show it.
struct RimmedWindow {
  float gray[kRimmed * kRimmed];
};

/// What a window of a level is compared with, each without its mean, row by row.
struct WindowTemplate {
  alignas(32) float gray[kWindow * kWindow];
  alignas(32) float slope_x[kWindow * kWindow];
  alignas(32) float slope_y[kWindow * kWindow];
};

/// Products of the template's slopes and grey values, summed: the normal equations.
struct TemplateSums {
  float xx, xy, xg, yy, yg, gg;
};

/// Fills the template.
TemplateSums make_template(const RimmedWindow& rimmed, WindowTemplate& window);

/// Sums over the window, r = level - gray: of r, r^2, and r times each of the template's.
struct WindowSums {
  float r, rr, rx, ry, rg;
};

/// The window whose first pixel lies `a` and `b` (0..1) right of and below `corner`; reads 9 x 9
/// pixels.
WindowSums compare(const WindowTemplate& window, const std::uint8_t* corner, std::ptrdiff_t stride,
                   float a, float b);

}  // namespace dynslam::features::detail
