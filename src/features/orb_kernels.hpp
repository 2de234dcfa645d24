// The stages of the ORB extractor that touch many pixels. Raw pointers only: the kernels know
// nothing of images or options. Each picks its vector instructions when it is called (Highway), and
// gives the same bits as its namesake in orb_reference.hpp whichever they are.
//
// A level's rows lie `stride` bytes apart with at least kRowSlack bytes behind the last pixel, and
// kRowSlack bytes before the first row and after the last belong to the buffer as well: kernels
// read (and write their outputs) past the end of a row, but not what they compute from.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::features::detail {

/// Bytes behind each row that kernels may touch; at least the longest vector (64) and a few.
inline constexpr int kRowSlack = 96;

struct PixelBlock {
  const std::uint8_t* data;
  std::ptrdiff_t stride;
  int width, height;
  const std::uint8_t* row(int y) const { return data + y * stride; }
};

struct MutablePixelBlock {
  std::uint8_t* data;
  std::ptrdiff_t stride;
  int width, height;
  std::uint8_t* row(int y) const { return data + y * stride; }
};

/// Linear interpolation along an axis: output i lies between inputs first[i] and first[i] + 1, with
/// weight[i] / 256 for the second.
struct ResizeAxis {
  const std::int32_t* first;
  const std::uint16_t* weight;
};

/// A corner of a level: pixel, FAST score, and how far from the pixel's centre the scores peak.
struct Corner {
  std::uint16_t x, y;
  std::uint8_t score;
  std::int8_t dx = 0, dy = 0;  ///< in kSubpixel, (-1/2, 1/2) pixel
};

/// Pixels that a step of Corner::dx and dy is worth.
inline constexpr float kSubpixel = 1.0F / 256.0F;

/// Where the parabola through the scores of a peak and of its two neighbours peaks, in kSubpixel;
/// one of the neighbours at least is below the peak.
inline std::int8_t peak_offset(int before, int peak, int after) {
  const int offset = 128 * (after - before) / (2 * peak - before - after);
  return static_cast<std::int8_t>(offset < 127 ? offset : 127);
}

struct Rotation {
  float cos, sin;
};

/// Gaussian, sigma 2, seven taps, in 1/256: the weights OpenCV has for this size.
inline constexpr int kBlurWeights[7] = {18, 34, 48, 56, 48, 34, 18};

struct CircleOffset {
  int x, y;
};

/// FAST's circle of radius 3, in order.
inline constexpr CircleOffset kCircle[16] = {
    {0, 3},  {1, 3},   {2, 2},   {3, 1},   {3, 0},  {3, -1}, {2, -2}, {1, -3},
    {0, -3}, {-1, -3}, {-2, -2}, {-3, -1}, {-3, 0}, {-3, 1}, {-2, 2}, {-1, 3}};

/// Round patch of the orientation: row v holds the columns -reach .. reach.
inline constexpr int kPatchRadius = 15;
inline constexpr int kPatchReach[kPatchRadius + 1] = {15, 15, 15, 15, 14, 14, 14, 13,
                                                      13, 12, 11, 10, 9,  8,  6,  3};

/// Bilinear reduction with 8-bit weights, rounded once. `scratch` holds source.width + kRowSlack
/// numbers.
void resize_level(const PixelBlock& source, const ResizeAxis& columns, const ResizeAxis& rows,
                  const MutablePixelBlock& target, std::uint16_t* scratch);

/// Gaussian blur with kBlurWeights, rounded once, mirrored at the border pixels (at least 4 pixels
/// on each side). `scratch` holds source.width + 2 kRowSlack numbers.
void blur_level(const PixelBlock& source, const MutablePixelBlock& target, std::uint16_t* scratch);

/// FAST-9 corners with a score above `threshold` that beat their eight neighbours, at least
/// `border`
/// (>= 4) pixels inside the level, by rows. `scratch` holds 3 strides; `corners` has room for
/// ((width + 1) / 2) ((height + 1) / 2) of them. Returns their number.
int fast_corners(const PixelBlock& level, int border, int threshold, std::uint8_t* scratch,
                 Corner* corners);

/// First moments of the round patch about each corner, at least 16 pixels inside the level.
void patch_moments(const PixelBlock& level, const Corner* corners, int count, std::int32_t* m10,
                   std::int32_t* m01);

/// 32 bytes of descriptor for each corner, at least 19 pixels inside the blurred level.
void rotated_brief(const PixelBlock& blurred, const Corner* corners, const Rotation* rotations,
                   int count, std::uint8_t* descriptors);

}  // namespace dynslam::features::detail
