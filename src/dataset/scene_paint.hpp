// Pictures for the textures of the rendered scene.
#pragma once

#include "scene_texture.hpp"

namespace dynslam::dataset::scene {

/// Grey grain around 128 for `Surface::detail`; `contrast` about 0.05 (plaster) to 0.3 (carpet).
Canvas paint_grain(Random random, float contrast, float stretch);

inline constexpr int kWallWidth = 1024, kWallHeight = 512;
enum class WallStyle { kPaint, kWallpaper, kBrick };
Canvas paint_wall(Random random, WallStyle style);
Canvas paint_parquet(Random random);
Canvas paint_ceiling(Random random);
Canvas paint_wood(Random random);
Canvas paint_plain(Random random);
Canvas paint_metal(Random random);
Canvas paint_poster(Random random);
Canvas paint_whiteboard(Random random);
Canvas paint_window(Random random);
Canvas paint_screen(Random random);
Canvas paint_books(Random random);
Canvas paint_cardboard(Random random);
Canvas paint_rug(Random random);
Canvas paint_leaves(Random random);
/// Printed cloth: 512 texels square, for 1.28 m.
Canvas paint_shirt(Random random);
Canvas paint_trousers(Random random);
Canvas paint_skin(Random random);
Canvas paint_hair(Random random);

}  // namespace dynslam::dataset::scene
