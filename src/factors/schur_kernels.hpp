// Elimination of point blocks from the normal equations of a bundle adjustment, dispatched at run
// time to the best instruction set.
#pragma once

#include <cstddef>
#include <cstdint>

namespace dynslam::factors::kernels {

// Blocks of 6 rows are stored column by column with 8 doubles a column, aligned, the last two 0.
inline constexpr std::size_t kColumn = 8;
inline constexpr std::size_t kCross = 3 * kColumn;   // camera by point
inline constexpr std::size_t kSquare = 6 * kColumn;  // camera by camera

struct Elimination {
  std::size_t points = 0;
  const std::uint32_t* entry_begin = nullptr;  // points + 1: entries (camera, point) of each point
  const std::uint32_t* entry_camera = nullptr;
  const double* cross = nullptr;              // kCross per entry: W = J_c' w J_p
  const double* inverse = nullptr;            // 9 per point: V^-1, row by row (symmetric)
  const double* gradient = nullptr;           // 3 per point: b_p
  const std::uint32_t* pair_block = nullptr;  // block of each pair of entries (a, b >= a) of each
                                              // point, in order
  double* scratch = nullptr;                  // kCross times the most entries of a point
  double* blocks = nullptr;                   // kSquare per block: -= W_a V^-1 W_b'
  double* rhs = nullptr;                      // kColumn per camera: -= W V^-1 b_p
};

void eliminate_points(const Elimination& e);

}  // namespace dynslam::factors::kernels
