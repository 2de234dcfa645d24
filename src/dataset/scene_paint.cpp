#include "scene_paint.hpp"

#include <algorithm>

namespace dynslam::dataset::scene {

namespace {

Color grey(float value) { return {value, value, value}; }

/// Warm, slightly tinted light colour.
Color pastel(Random& random, float brightness) {
  return random_color(random, brightness, random.uniformf(0.06F, 0.22F));
}

}  // namespace

Canvas paint_grain(Random random, float contrast, float stretch) {
  Canvas canvas(512, 512, grey(128.0F));
  canvas.modulate(random, contrast, 24, 4, 0.85F, stretch);
  // Sparse specks: single texels of grain that a corner detector can hold on to from close by.
  for (int i = 0; i < 1200; ++i) {
    const float k = 1.0F + contrast * random.uniformf(-1.6F, 1.2F);
    canvas.rectangle(random.below(512), random.below(512), 2 + random.below(4), 2 + random.below(4),
                     grey(128.0F * k));
  }
  return canvas;
}

Canvas paint_wall(Random random, WallStyle style) {
  constexpr int kWidth = kWallWidth, kHeight = kWallHeight;
  const Color base = pastel(random, random.uniformf(165.0F, 200.0F));
  Canvas canvas(kWidth, kHeight, base);
  if (style == WallStyle::kBrick) {
    canvas = Canvas(kWidth, kHeight, grey(150.0F));
    const int brick_w = 40, brick_h = 14;
    for (int row = 0; row * brick_h < kHeight; ++row) {
      for (int column = -1; column * brick_w < kWidth - brick_w / 2; ++column) {
        const float tone = random.uniformf(0.6F, 1.15F);
        const Color brick = Color{62.0F, 78.0F, 138.0F} * tone + grey(random.uniformf(0.0F, 25.0F));
        canvas.rectangle(column * brick_w + (row % 2) * brick_w / 2, row * brick_h, brick_w - 2,
                         brick_h - 2, brick);
      }
    }
  } else if (style == WallStyle::kWallpaper) {
    for (int i = 0; i < 360; ++i) {  // a motif, nowhere the same
      const int x = random.below(kWidth), y = random.below(kHeight);
      const Color ink = random_color(random, random.uniformf(90.0F, 190.0F), 0.3F);
      const int size = 4 + random.below(9);
      canvas.disc(x, y, size, ink);
      canvas.disc(x + random.below(5) - 2, y + random.below(5) - 2, size / 2, base * 0.9F);
      canvas.rectangle(x - 1, y, 2, size + 4 + random.below(12), ink * 0.8F);
    }
  } else {
    for (int i = 0; i < 90; ++i) {  // scuffs and nails
      const Color mark = base * random.uniformf(0.55F, 0.9F);
      canvas.rectangle(random.below(kWidth), random.below(kHeight), 1 + random.below(14),
                       1 + random.below(4), mark);
    }
  }
  canvas.modulate(random, 0.16F, 4, 6, 0.8F);
  canvas.rectangle(0, 0, kWidth, 14, grey(95.0F));  // skirting board
  return canvas;
}

Canvas paint_parquet(Random random) {
  Canvas canvas(1024, 1024, grey(40.0F));
  for (int row = 0; row < 1024; row += 16) {
    for (int x = -random.below(150); x < 1024;) {
      const int length = 90 + random.below(120);
      const Color wood = Color{62.0F, 98.0F, 142.0F} * random.uniformf(0.65F, 1.2F);
      canvas.rectangle(x, row, length - 2, 15, wood);
      x += length;
    }
  }
  canvas.modulate(random, 0.22F, 24, 5, 0.8F, 6.0F);
  return canvas;
}

Canvas paint_ceiling(Random random) {
  Canvas canvas(512, 512, grey(205.0F));
  canvas.modulate(random, 0.05F, 8, 5, 0.8F);
  for (int i = 0; i < 512; i += 64) {
    canvas.rectangle(i, 0, 1, 512, grey(160.0F));
    canvas.rectangle(0, i, 512, 1, grey(160.0F));
  }
  return canvas;
}

Canvas paint_wood(Random random) {
  const Color base = Color{70.0F, 110.0F, 160.0F} * random.uniformf(0.6F, 1.15F);
  Canvas canvas(512, 512, base);
  canvas.modulate(random, 0.45F, 24, 5, 0.75F, 9.0F);
  for (int i = 0; i < 14; ++i) {  // knots
    const int x = random.below(512), y = random.below(512), r = 3 + random.below(5);
    canvas.disc(x, y, r, base * 0.45F);
    canvas.disc(x, y, r / 2, base * 0.7F);
  }
  return canvas;
}

Canvas paint_plain(Random random) {
  Canvas canvas(256, 256, pastel(random, random.uniformf(120.0F, 210.0F)));
  canvas.modulate(random, 0.06F, 4, 6, 0.9F);
  return canvas;
}

Canvas paint_metal(Random random) {
  Canvas canvas(256, 256, grey(random.uniformf(70.0F, 130.0F)));
  canvas.modulate(random, 0.10F, 6, 5, 0.9F, 4.0F);
  return canvas;
}

Canvas paint_poster(Random random) {
  const Color paper = pastel(random, random.uniformf(190.0F, 240.0F));
  Canvas canvas(256, 256, paper);
  const Color ink = random_color(random, random.uniformf(20.0F, 90.0F), 0.7F);
  const int split = 70 + random.below(110);
  canvas.rectangle(10, 10, 236, split, random_color(random, random.uniformf(90.0F, 220.0F), 0.6F));
  for (int i = 0; i < 26; ++i) {
    const Color color = random_color(random, random.uniformf(30.0F, 240.0F), 0.75F);
    const int x = 12 + random.below(200), y = 12 + random.below(split - 16);
    const int w = 6 + random.below(36), h = 6 + random.below(30);
    if (random.chance(0.55)) {
      canvas.rectangle(x, y, std::min(w, 244 - x), std::min(h, split + 8 - y), color);
    } else {
      canvas.disc(std::clamp(x, 26, 228), std::clamp(y, 22, std::max(22, split - 6)),
                  4 + random.below(12), color);
    }
  }
  canvas.print(random, 16, split + 20, 224, 26, 18, ink);
  canvas.print(random, 16, split + 52, 224, 244 - (split + 52), 6 + random.below(4), ink);
  canvas.modulate(random, 0.08F, 4, 6, 0.8F);
  canvas.rectangle(0, 0, 256, 4, ink);
  canvas.rectangle(0, 252, 256, 4, ink);
  canvas.rectangle(0, 0, 4, 256, ink);
  canvas.rectangle(252, 0, 4, 256, ink);
  return canvas;
}

Canvas paint_whiteboard(Random random) {
  Canvas canvas(512, 256, grey(225.0F));
  const Color inks[] = {{180.0F, 70.0F, 40.0F}, {50.0F, 50.0F, 190.0F}, {45.0F, 45.0F, 45.0F}};
  for (int i = 0; i < 5; ++i) {
    const int x = 20 + random.below(330), y = 20 + random.below(170);
    canvas.print(random, x, y, 90 + random.below(60), 40, 9, inks[random.below(3)]);
  }
  canvas.modulate(random, 0.03F, 4, 4, 0.8F);
  for (const int edge : {0, 506}) canvas.rectangle(edge, 0, 6, 256, grey(110.0F));
  for (const int edge : {0, 250}) canvas.rectangle(0, edge, 512, 6, grey(110.0F));
  return canvas;
}

Canvas paint_window(Random random) {
  Canvas canvas(256, 256, {245.0F, 235.0F, 225.0F});
  canvas.rectangle(0, 130, 256, 126, {120.0F, 165.0F, 130.0F});
  for (int i = 0; i < 40; ++i) {  // leaves and roofs out of doors
    canvas.disc(random.below(256), 110 + random.below(140), 5 + random.below(14),
                Color{80.0F, 150.0F, 100.0F} * random.uniformf(0.6F, 1.4F));
  }
  canvas.modulate(random, 0.08F, 6, 4, 0.8F);
  for (const int x : {0, 122, 244}) canvas.rectangle(x, 0, 12, 256, grey(190.0F));
  for (const int y : {0, 80, 246}) canvas.rectangle(0, y, 256, 10, grey(190.0F));
  return canvas;
}

Canvas paint_screen(Random random) {
  Canvas canvas(256, 128, {60.0F, 40.0F, 30.0F});
  for (int i = 0; i < 4; ++i) {
    const int x = 8 + random.below(140), y = 6 + random.below(50);
    canvas.rectangle(x, y, 90, 60, grey(random.uniformf(150.0F, 235.0F)));
    canvas.rectangle(x, y, 90, 6, random_color(random, 200.0F, 0.6F));
    canvas.print(random, x + 4, y + 10, 82, 46, 4, grey(40.0F));
  }
  for (const int edge : {0, 252}) canvas.rectangle(edge, 0, 4, 128, grey(18.0F));
  for (const int edge : {0, 124}) canvas.rectangle(0, edge, 256, 4, grey(18.0F));
  return canvas;
}

Canvas paint_books(Random random) {
  Canvas canvas(128, 128, grey(25.0F));
  for (int x = 0; x < 124;) {
    const int width = 14 + random.below(18), height = 96 + random.below(30);
    const Color cover =
        random_color(random, random.uniformf(60.0F, 220.0F), random.uniformf(0.2F, 0.65F));
    canvas.rectangle(x, 128 - height, std::min(width, 127 - x), height, cover);
    const Color label = random_color(random, random.uniformf(120.0F, 240.0F), 0.3F);
    canvas.rectangle(x + 3, 128 - height + 10 + random.below(20), std::min(width, 127 - x) - 6,
                     18 + random.below(26), label);
    if (random.chance(0.7)) {
      canvas.rectangle(x, 104 + random.below(12), std::min(width, 127 - x), 4, label);
    }
    x += width + 1;
  }
  canvas.modulate(random, 0.15F, 6, 4, 0.8F);
  return canvas;
}

Canvas paint_cardboard(Random random) {
  const Color board = Color{105.0F, 150.0F, 188.0F} * random.uniformf(0.85F, 1.1F);
  Canvas canvas(256, 256, board);
  canvas.rectangle(112, 0, 30, 256, board * 1.2F + grey(12.0F));  // tape
  for (int i = 0; i < 7; ++i) {
    const int x = 10 + random.below(170), y = 10 + random.below(180);
    const Color ink = random_color(random, random.uniformf(20.0F, 110.0F), 0.6F);
    if (random.chance(0.5)) {
      canvas.rectangle(x, y, 64, 44, grey(232.0F));
      canvas.print(random, x + 5, y + 5, 54, 34, 7, ink);
    } else {
      canvas.print(random, x, y, 76, 46, 18, ink);
    }
  }
  canvas.scatter(random, 26, 3, 12, 160.0F, 0.6F);
  canvas.modulate(random, 0.14F, 6, 5, 0.85F);
  return canvas;
}

Canvas paint_rug(Random random) {
  Canvas canvas(512, 256, random_color(random, 110.0F, 0.4F));
  canvas.scatter(random, 260, 6, 34, 180.0F, 0.4F);
  canvas.modulate(random, 0.25F, 24, 4, 0.9F);
  for (const int edge : {0, 500}) canvas.rectangle(edge, 0, 12, 256, grey(70.0F));
  for (const int edge : {0, 244}) canvas.rectangle(0, edge, 512, 12, grey(70.0F));
  return canvas;
}

Canvas paint_leaves(Random random) {
  Canvas canvas(256, 256, {30.0F, 70.0F, 40.0F});
  for (int i = 0; i < 500; ++i) {
    canvas.disc(random.below(256), random.below(256), 3 + random.below(6),
                Color{50.0F, 120.0F, 70.0F} * random.uniformf(0.5F, 1.6F));
  }
  return canvas;
}

Canvas paint_shirt(Random random) {
  const Color base = random_color(random, random.uniformf(90.0F, 190.0F), 0.45F);
  Canvas canvas(512, 512, base);
  for (int i = 0; i < 14; ++i) {  // stripes of no regular distance
    canvas.rectangle(0, random.below(512), 512, 4 + random.below(9),
                     random_color(random, random.uniformf(40.0F, 230.0F), 0.5F));
  }
  canvas.scatter(random, 520, 4, 22, 235.0F, 0.5F);
  for (int i = 0; i < 22; ++i) {
    canvas.print(random, random.below(512), random.below(512), 60, 30, 13,
                 random.chance(0.5) ? grey(240.0F) : grey(25.0F));
  }
  canvas.modulate(random, 0.22F, 10, 6, 0.85F);
  return canvas;
}

Canvas paint_trousers(Random random) {
  const Color base = random_color(random, random.uniformf(60.0F, 120.0F), 0.45F);
  Canvas canvas(512, 512, base);
  canvas.scatter(random, 200, 3, 14, 170.0F, 0.35F);
  for (int i = 0; i < 20; ++i) {
    canvas.rectangle(random.below(512), random.below(512), 2, 60 + random.below(120), base * 1.5F);
  }
  canvas.modulate(random, 0.35F, 12, 6, 0.85F);
  return canvas;
}

Canvas paint_skin(Random random) {
  const float tone = random.uniformf(0.55F, 1.0F);
  Canvas canvas(256, 256, Color{140.0F, 165.0F, 215.0F} * tone);
  canvas.modulate(random, 0.12F, 6, 5, 0.8F);
  // A face of sorts, looking along +x (angle 0 = column 0): eyes, brows and mouth. One texel is
  // 2.5 mm; the head's middle is row 128.
  const Color dark = Color{35.0F, 30.0F, 45.0F} * tone;
  for (const int side : {-1, 1}) {
    canvas.rectangle(side * 13 - 4, 132, 8, 4, grey(215.0F));
    canvas.rectangle(side * 13 - 2, 132, 4, 4, dark);
    canvas.rectangle(side * 13 - 6, 140, 12, 3, dark);
  }
  canvas.rectangle(-9, 106, 18, 4, Color{80.0F, 80.0F, 150.0F} * tone);
  canvas.rectangle(-3, 116, 6, 12, Color{110.0F, 130.0F, 180.0F} * tone);
  return canvas;
}

Canvas paint_hair(Random random) {
  const float tone = random.uniformf(0.3F, 1.0F);
  Canvas canvas(256, 256, Color{35.0F, 55.0F, 85.0F} * tone);
  canvas.modulate(random, 0.5F, 10, 5, 0.9F, 0.25F);
  return canvas;
}

}  // namespace dynslam::dataset::scene
