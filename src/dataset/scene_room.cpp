// Room and furniture.
#include <utility>
#include <vector>

#include "scene_light.hpp"
#include "scene_paint.hpp"
#include "scene_world.hpp"

namespace dynslam::dataset::scene {

namespace {

using Eigen::Vector3d;

RigidTransform placed(const Vector3d& center, double yaw) {
  return {Eigen::AngleAxisd(yaw, Vector3d::UnitZ()).toRotationMatrix(), center};
}

/// Order of World::grains.
enum Finish { kPlaster, kWoodGrain, kFabric, kSmooth };

class RoomBuilder {
 public:
  explicit RoomBuilder(std::uint64_t seed) : seed_(seed), random_(seed, 1) {
    for (const auto& [contrast, stretch] : {std::pair(0.22F, 1.0F), std::pair(0.22F, 6.0F),
                                            std::pair(0.32F, 1.0F), std::pair(0.05F, 1.0F)}) {
      world_.grains.emplace_back(
          [random = fresh(), c = contrast, s = stretch] { return paint_grain(random, c, s); });
    }
    for (int& wood : wood_) wood = picture(512, 512, paint_wood);
    for (int& plain : plain_) plain = picture(256, 256, paint_plain);
    metal_ = picture(256, 256, paint_metal);
    for (int& carton : carton_) carton = picture(256, 256, paint_cardboard);
    for (int& books : books_) books = picture(128, 128, paint_books);
  }

  World build() {
    add_shell();
    add_shelf();
    add_desk();
    add_cabinet();
    add_door_and_window();
    add_sofa();
    add_loose_things();
    add_posters();
    return std::move(world_);
  }

 private:
  /// A generator of its own for every thing.
  Random fresh() { return Random(seed_, 1000 + 7 * next_++); }
  int picture(int width, int height, Canvas (*paint)(Random)) {
    return world_.add_texture(width, height, [paint, random = fresh()] { return paint(random); });
  }
  double jitter(double amount) { return random_.uniform(-amount, amount); }

  /// Texture repeated at `texels` a metre from a random place.
  Surface tiled(int texture, double texels, Finish finish) {
    Surface s;
    const Recipe& t = world_.recipes[static_cast<std::size_t>(texture)];
    s.texture = texture;
    s.scale_u = s.scale_v = static_cast<float>(texels);
    s.offset_u = static_cast<float>(8 * t.width + random_.below(t.width));
    s.offset_v = static_cast<float>(8 * t.height + random_.below(t.height));
    set_grain(s, finish);
    return s;
  }
  void set_grain(Surface& s, Finish finish) {
    s.detail = finish;
    s.detail_offset_u = static_cast<float>(2048 + random_.below(512));
    s.detail_offset_v = static_cast<float>(2048 + random_.below(512));
  }
  /// Stretches a texture over one face, upright.
  void fit(int solid, int face, int texture) {
    Surface& s = world_.face(solid, face);
    const Recipe& t = world_.recipes[static_cast<std::size_t>(texture)];
    const Vector3d& size = world_.solids[static_cast<std::size_t>(solid)].size;
    const auto axis = static_cast<std::size_t>(face / 2);
    s.texture = texture;
    s.scale_u = static_cast<float>(t.width / (2.0 * size[kFaceU[axis]]));
    s.scale_v = static_cast<float>(t.height / (2.0 * size[kFaceV[axis]]));
    if (face < 4 && solid != 0) s.scale_v = -s.scale_v;  // pictures have their first row on top
    s.offset_u = static_cast<float>(t.width) * 0.5F;
    s.offset_v = static_cast<float>(t.height) * 0.5F;
  }
  int box(const Vector3d& center, const Vector3d& half, double yaw, const Surface& look) {
    return world_.add_solid(Shape::kBox, 0, placed(center, yaw), half, look);
  }
  /// Every face from another place of the texture, so that no two look the same.
  int varied_box(const Vector3d& center, const Vector3d& half, double yaw, int texture,
                 double texels, Finish finish) {
    const int solid = box(center, half, yaw, tiled(texture, texels, finish));
    for (int face = 0; face < 6; ++face) {
      const Surface other = tiled(texture, texels, finish);
      Surface& s = world_.face(solid, face);
      s.offset_u = other.offset_u;
      s.offset_v = other.offset_v;
      s.detail_offset_u = other.detail_offset_u;
      s.detail_offset_v = other.detail_offset_v;
    }
    return solid;
  }
  void shine(int solid, float light) {
    for (int face = 0; face < 6; ++face) world_.face(solid, face).shine = light;
  }
  int wood() { return wood_[random_.below(2)]; }
  int plain() { return plain_[random_.below(3)]; }

  void add_shell();
  void add_shelf();
  void add_desk();
  void add_cabinet();
  void add_door_and_window();
  void add_sofa();
  void add_loose_things();
  void add_posters();
  void add_poster(int face, double along, double height, double half_w, double half_h);
  void add_round(Shape shape, const Vector3d& center, const Vector3d& size, int texture,
                 double texels, Finish finish);

  std::uint64_t seed_;
  std::uint64_t next_ = 0;
  Random random_;
  World world_;
  int wood_[2] = {}, plain_[3] = {}, carton_[3] = {}, books_[18] = {}, metal_ = 0;
};

void RoomBuilder::add_shell() {
  const Vector3d size(kRoomX, kRoomY, kRoomZ / 2);
  const int room = world_.add_solid(Shape::kRoom, 0, placed({0, 0, kRoomZ / 2}, 0.0), size,
                                    tiled(plain_[0], 100, kPlaster));
  WallStyle styles[4];
  for (WallStyle& style : styles) style = static_cast<WallStyle>(random_.below(3));
  if (styles[2] == WallStyle::kPaint) styles[2] = WallStyle::kWallpaper;  // the wall ahead
  for (int face = 0; face < 4; ++face) {
    fit(room, face,
        world_.add_texture(
            kWallWidth, kWallHeight,
            [random = fresh(), style = styles[face]] { return paint_wall(random, style); }, face));
    set_grain(world_.face(room, face), kPlaster);
  }
  fit(room, 4, picture(512, 512, paint_ceiling));
  world_.recipes.back().room_face = 4;
  set_grain(world_.face(room, 4), kSmooth);
  fit(room, 5, picture(1024, 1024, paint_parquet));
  world_.recipes.back().room_face = 5;
  set_grain(world_.face(room, 5), kWoodGrain);
  world_.face(room, 5).takes_shadows = true;

  const int rug = box({jitter(0.2), 0.75 + jitter(0.1), 0.006}, {1.25, 0.75, 0.006}, jitter(0.15),
                      tiled(plain_[0], 100, kFabric));
  fit(rug, 4, picture(512, 256, paint_rug));
  world_.face(rug, 4).takes_shadows = true;
}

void RoomBuilder::add_shelf() {
  const double x = -1.55 + jitter(0.25), depth = 0.16, half_w = 0.62, height = 2.05;
  const double y = kRoomY - depth - 0.01;
  const int board = wood();
  for (const int side : {-1, 1}) {
    varied_box({x + side * half_w, y, height / 2}, {0.012, depth, height / 2}, 0, board, 260,
               kWoodGrain);
  }
  varied_box({x, kRoomY - 0.008, height / 2}, {half_w, 0.007, height / 2}, 0, board, 260,
             kWoodGrain);
  for (int level = 0; level < 6; ++level) {
    const double z = 0.06 + level * 0.39;
    varied_box({x, y, z}, {half_w - 0.013, depth, 0.011}, 0, board, 260, kWoodGrain);
    if (level == 5) break;
    double at = x - half_w + 0.03;
    while (at < x + half_w - 0.2) {
      const double width = random_.uniform(0.09, 0.24), tall = random_.uniform(0.2, 0.31);
      const double deep = random_.uniform(0.09, 0.13);
      if (random_.chance(0.8)) {
        const int row = box({at + width / 2, y + depth - 0.02 - deep, z + 0.012 + tall / 2},
                            {width / 2, deep, tall / 2}, 0, tiled(plain(), 200, kSmooth));
        fit(row, 3, books_[random_.below(18)]);
      }
      at += width + (random_.chance(0.35) ? random_.uniform(0.03, 0.12) : 0.002);
    }
  }
}

void RoomBuilder::add_desk() {
  const double x = 1.25 + jitter(0.25), y = 2.05, top = 0.74;
  const int board = wood();
  varied_box({x, y, top}, {0.75, 0.38, 0.018}, 0, board, 260, kWoodGrain);
  for (const int sx : {-1, 1}) {
    for (const int sy : {-1, 1}) {
      varied_box({x + sx * 0.7, y + sy * 0.33, top / 2 - 0.01}, {0.025, 0.025, top / 2 - 0.01}, 0,
                 metal_, 200, kSmooth);
    }
  }
  varied_box({x + 0.45, y + 0.05, 0.33}, {0.2, 0.3, 0.32}, 0, board, 260, kWoodGrain);
  const double mx = x - 0.15 + jitter(0.1), yaw = jitter(0.25);
  const int screen =
      varied_box({mx, y + 0.1, top + 0.32}, {0.29, 0.02, 0.19}, yaw, metal_, 200, kSmooth);
  fit(screen, 3, picture(256, 128, paint_screen));
  shine(screen, 0.95F);
  varied_box({mx, y + 0.13, top + 0.1}, {0.03, 0.02, 0.1}, yaw, metal_, 200, kSmooth);
  varied_box({mx, y - 0.2, top + 0.028}, {0.22, 0.07, 0.01}, yaw, metal_, 300, kFabric);
  double z = top + 0.018;
  for (int i = 0; i < 4; ++i) {  // a pile of books
    const double half = random_.uniform(0.015, 0.035);
    const int book = varied_box({x + 0.5 + jitter(0.02), y - 0.05, z + half}, {0.13, 0.1, half},
                                jitter(0.4), plain(), 200, kSmooth);
    fit(book, 4, books_[random_.below(18)]);
    z += 2 * half;
  }
  add_round(Shape::kCylinder, {mx - 0.42, y - 0.1, top + 0.07}, {0.04, 0.04, 0.05}, carton_[0], 500,
            kSmooth);
  // The chair, pushed aside.
  const double cx = x - 0.25 + jitter(0.2), cy = 1.62, turn = jitter(0.6);
  const RigidTransform chair = placed({cx, cy, 0}, turn);
  varied_box(chair * Vector3d(0, 0, 0.46), {0.22, 0.21, 0.03}, turn, plain(), 200, kFabric);
  varied_box(chair * Vector3d(0, -0.2, 0.78), {0.2, 0.02, 0.2}, turn, carton_[1], 300, kFabric);
  for (const int sx : {-1, 1}) {
    for (const int sy : {-1, 1}) {
      varied_box(chair * Vector3d(sx * 0.19, sy * 0.18, sy < 0 ? 0.4 : 0.215),
                 {0.015, 0.015, sy < 0 ? 0.4 : 0.215}, turn, metal_, 200, kSmooth);
    }
  }
}

void RoomBuilder::add_cabinet() {
  const double y = 1.0 + jitter(0.3), x = -kRoomX + 0.235, height = 1.05;
  const int front = wood();
  varied_box({x, y, height / 2 + 0.03}, {0.225, 0.62, height / 2 - 0.03}, 0, front, 260,
             kWoodGrain);
  for (const int side : {-1, 1}) {  // doors with handles
    varied_box({x + 0.232, y + side * 0.305, height / 2 + 0.03}, {0.008, 0.295, 0.46}, 0, front,
               260, kWoodGrain);
    varied_box({x + 0.25, y + side * 0.06, height / 2 + 0.1}, {0.012, 0.008, 0.07}, 0, metal_, 200,
               kSmooth);
  }
  for (int i = 0; i < 3; ++i) {
    const double half = random_.uniform(0.09, 0.17);
    const double at = y - 0.42 + 0.4 * i + jitter(0.05);
    const int carton = varied_box({x + jitter(0.03), at, height + half}, {0.13, 0.14, half},
                                  jitter(0.4), carton_[random_.below(3)], 500, kFabric);
    fit(carton, 0, carton_[random_.below(3)]);
  }
}

void RoomBuilder::add_door_and_window() {
  const double door_y = -1.3 + jitter(0.15);
  const int door =
      varied_box({-kRoomX + 0.02, door_y, 1.02}, {0.02, 0.45, 1.02}, 0, plain(), 150, kSmooth);
  (void)door;
  varied_box({-kRoomX + 0.06, door_y + 0.36, 1.03}, {0.02, 0.06, 0.012}, 0, metal_, 200, kSmooth);
  const double y = 0.5 + jitter(0.3);
  const int window =
      box({kRoomX - 0.02, y, 1.65}, {0.02, 0.75, 0.6}, 0, tiled(metal_, 100, kSmooth));
  fit(window, 1, picture(256, 256, paint_window));
  shine(window, 1.08F);
  for (int i = 0; i < 9; ++i) {  // radiator
    varied_box({kRoomX - 0.07, y - 0.6 + 0.15 * i, 0.45}, {0.05, 0.055, 0.3}, 0, plain_[1], 200,
               kSmooth);
  }
}

void RoomBuilder::add_sofa() {
  const double y = -0.75 + jitter(0.2), x = kRoomX - 0.45;
  const int cloth = plain_[2];
  varied_box({x, y, 0.22}, {0.42, 0.8, 0.2}, 0, cloth, 200, kFabric);
  varied_box({x + 0.32, y, 0.55}, {0.1, 0.8, 0.3}, 0, cloth, 200, kFabric);
  for (const int side : {-1, 1}) {
    varied_box({x, y + side * 0.86, 0.32}, {0.42, 0.08, 0.3}, 0, cloth, 200, kFabric);
    const int cushion = varied_box({x + 0.14, y + side * 0.45 + jitter(0.1), 0.58},
                                   {0.07, 0.2, 0.17}, jitter(0.3), carton_[1], 400, kFabric);
    fit(cushion, 1, picture(512, 256, paint_rug));
  }
}

void RoomBuilder::add_round(Shape shape, const Vector3d& center, const Vector3d& size, int texture,
                            double texels, Finish finish) {
  Surface look = tiled(texture, texels, finish);
  look.lit_by_normal = true;
  world_.add_solid(shape, 0, placed(center, random_.uniform(0.0, 6.0)), size, look);
}

void RoomBuilder::add_loose_things() {
  const int leaves = picture(256, 256, paint_leaves);
  const double px = -2.65 + jitter(0.1), py = 2.1;
  add_round(Shape::kCylinder, {px, py, 0.2}, {0.17, 0.17, 0.2}, carton_[2], 300, kPlaster);
  add_round(Shape::kCylinder, {px, py, 0.6}, {0.025, 0.025, 0.25}, wood_[0], 260, kWoodGrain);
  for (int i = 0; i < 5; ++i) {
    add_round(Shape::kEllipsoid, {px + jitter(0.12), py + jitter(0.12), 0.8 + 0.14 * i},
              {random_.uniform(0.12, 0.22), random_.uniform(0.12, 0.2), random_.uniform(0.1, 0.17)},
              leaves, 400, kFabric);
  }
  add_round(Shape::kCylinder, {0.2 + jitter(0.1), 2.3, 0.17}, {0.13, 0.13, 0.17}, metal_, 200,
            kSmooth);  // waste-paper basket
  add_round(Shape::kEllipsoid, {-0.45 + jitter(0.1), 2.0 + jitter(0.1), 0.12}, {0.12, 0.12, 0.12},
            picture(512, 256, paint_rug), 500, kFabric);  // ball
  const double lx = 2.6 + jitter(0.1), ly = 2.15;         // floor lamp
  add_round(Shape::kCylinder, {lx, ly, 0.015}, {0.15, 0.15, 0.015}, metal_, 200, kSmooth);
  add_round(Shape::kCylinder, {lx, ly, 0.8}, {0.015, 0.015, 0.78}, metal_, 200, kSmooth);
  add_round(Shape::kEllipsoid, {lx, ly, 1.65}, {0.2, 0.2, 0.15}, plain_[0], 200, kFabric);
  double z = 0.0;
  for (int i = 0; i < 3; ++i) {  // cartons in the corner
    const double half = random_.uniform(0.14, 0.22), wide = 0.3 - 0.03 * i;
    const int carton =
        varied_box({2.55 - 0.9 * (i == 2 ? 0.0 : 0.02 * i), 1.45, z + half},
                   {wide, wide * 0.85, half}, jitter(0.25), carton_[i], 450, kFabric);
    fit(carton, 1, carton_[i]);
    fit(carton, 3, carton_[(i + 1) % 3]);
    z += 2 * half;
  }
  for (const int side : {-1, 1}) {  // ceiling lamps
    const int lamp = box({side * kLampX, kLampY, kRoomZ - 0.02}, {kLampHalfX, kLampHalfY, 0.02}, 0,
                         tiled(plain_[0], 100, kSmooth));
    shine(lamp, 1.5F);
  }
}

void RoomBuilder::add_poster(int face, double along, double height, double half_w, double half_h) {
  constexpr double kThick = 0.006;
  const int axis = face / 2, sign = face % 2 == 0 ? 1 : -1;
  Vector3d center(along, along, height), half(half_w, half_w, half_h);
  center[axis] = sign * ((axis == 0 ? kRoomX : kRoomY) - kThick);
  half[axis] = kThick;
  const int poster = box(center, half, 0, tiled(plain_[0], 100, kSmooth));
  fit(poster, face ^ 1, picture(256, 256, paint_poster));
}

void RoomBuilder::add_posters() {
  constexpr int kAhead = 2, kBehind = 3, kLeft = 1, kRight = 0;
  for (double x = -0.55; x < 0.5; x += random_.uniform(0.5, 0.65)) {
    add_poster(kAhead, x, 1.55 + jitter(0.3), random_.uniform(0.17, 0.23),
               random_.uniform(0.2, 0.3));
  }
  const int board = box({1.35 + jitter(0.2), kRoomY - 0.012, 1.75}, {0.6, 0.012, 0.4}, 0,
                        tiled(metal_, 100, kSmooth));
  fit(board, 3, picture(512, 256, paint_whiteboard));
  add_poster(kAhead, 2.3 + jitter(0.1), 1.2 + jitter(0.1), 0.2, 0.28);
  add_poster(kAhead, -0.3 + jitter(0.2), 2.35, 0.35, 0.17);
  add_poster(kAhead, 0.15 + jitter(0.1), 0.75, 0.2, 0.2);
  for (double y = -0.4; y < 2.0; y += random_.uniform(0.55, 0.8)) {
    add_poster(kLeft, y, 1.85 + jitter(0.15), random_.uniform(0.18, 0.25),
               random_.uniform(0.2, 0.3));
  }
  add_poster(kRight, -1.0 + jitter(0.2), 1.6, 0.3, 0.25);
  add_poster(kRight, 1.75 + jitter(0.1), 1.9 + jitter(0.1), 0.22, 0.3);
  for (double x = -2.0; x < 2.2; x += random_.uniform(0.7, 1.1)) {
    add_poster(kBehind, x, 1.5 + jitter(0.3), random_.uniform(0.2, 0.3), random_.uniform(0.2, 0.3));
  }
}

}  // namespace

World build_room(std::uint64_t seed) { return RoomBuilder(seed).build(); }

}  // namespace dynslam::dataset::scene
