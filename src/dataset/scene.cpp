#include "dynslam/dataset/scene.hpp"

#include <cmath>
#include <cstdio>
#include <limits>
#include <mutex>
#include <utility>

#include "dynslam/core/errors.hpp"

#include "scene_frame.hpp"

namespace dynslam::dataset {

using scene::BodyPoses;

DepthCamera scene_camera(int width, int height) {
  DepthCamera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 525.0 * width / 640.0;
  camera.cx = 0.5 * (width - 1);
  camera.cy = 0.5 * (height - 1);
  camera.bf = camera.fx * 40.0 / 525.0;
  return camera;
}

void SceneOptions::validate() const {
  constexpr auto kName = "SceneOptions";
  require(frames >= 1 && frames <= 1000000, kName, "frames", frames, "1 to 1000000");
  require(fps > 0.0 && fps <= 1000.0, kName, "fps", fps, "more than 0 and at most 1000");
  require(std::isfinite(start_time), kName, "start_time", start_time, "a finite number of seconds");
  camera.validate();
  for (const auto& [side, pixels] :
       {std::pair("camera.width", camera.width), std::pair("camera.height", camera.height)}) {
    require(pixels >= 16 && pixels <= 8192, kName, side, pixels, "16 to 8192 pixels");
  }
  require(motion >= CameraMotion::kHandHeld && motion <= CameraMotion::kRound, kName, "motion",
          static_cast<int>(motion), "one of CameraMotion");
  require(camera_speed >= 0.0 && camera_speed <= 4.0, kName, "camera_speed", camera_speed,
          "0 to 4");
  require(tremor >= 0.0 && tremor <= 10.0, kName, "tremor", tremor, "0 to 10");
  require(mover_speed >= 0.0 && mover_speed <= 3.0, kName, "mover_speed", mover_speed, "0 to 3");
  require(exposure_time >= 0.0 && exposure_time <= 1.0 / fps, kName, "exposure_time", exposure_time,
          "0 to 1 / fps seconds");
  require(stereo_baseline >= 0.0 && stereo_baseline <= 2.0, kName, "stereo_baseline",
          stereo_baseline, "0 to 2 metres");
  require(threads >= 1 && threads <= 64, kName, "threads", threads, "1 to 64");
}

namespace {

/// What depends on the seed alone, shared by all variants of a scene.
class Room {
 public:
  explicit Room(std::uint64_t seed) : world(scene::build_room(seed)) {
    scene::add_people(world, seed);
  }
  /// Painted when colours are wanted for the first time.
  const scene::Appearance& look() const {
    std::call_once(painted_, [this] { look_ = scene::paint_world(world); });
    return look_;
  }
  scene::World world;

 private:
  mutable std::once_flag painted_;
  mutable scene::Appearance look_;
};

}  // namespace

struct RenderedScene::Impl {
  SceneOptions options;
  std::shared_ptr<const Room> room;
  const scene::World& world;
  scene::Motion motion;
  mutable std::mutex mutex;
  mutable std::vector<std::unique_ptr<scene::Workspace>> idle;  ///< memory that nobody uses now

  /// The options are valid.
  Impl(const SceneOptions& o, std::shared_ptr<const Room> r)
      : options(o), room(std::move(r)), world(room->world), motion(o) {
    if (o.stereo_baseline > 0.0) options.camera.bf = o.stereo_baseline * o.camera.fx;
  }

  double time(std::size_t index) const { return static_cast<double>(index) / options.fps; }

  /// Workspace for the time of one call.
  class Loan {
   public:
    explicit Loan(const Impl& impl) : impl_(impl) {
      {
        const std::lock_guard<std::mutex> lock(impl.mutex);
        if (!impl.idle.empty()) {
          work_ = std::move(impl.idle.back());
          impl.idle.pop_back();
        }
      }
      if (!work_) work_ = std::make_unique<scene::Workspace>();
      work_->prepare(impl.options.camera.width, impl.options.camera.height, impl.options.threads);
    }
    ~Loan() {
      const std::lock_guard<std::mutex> lock(impl_.mutex);
      impl_.idle.push_back(std::move(work_));
    }
    Loan(const Loan&) = delete;
    Loan& operator=(const Loan&) = delete;
    scene::Workspace& operator*() const { return *work_; }

   private:
    const Impl& impl_;
    std::unique_ptr<scene::Workspace> work_;
  };

  scene::View view(const RigidTransform& T_world_cam, const BodyPoses& bodies) const {
    return {world, options.camera, T_world_cam, bodies, options.movers};
  }

  /// Motion of every body relative to the camera during the exposure around t.
  std::vector<Vector6d> exposure_motion(double t, const RigidTransform& T_left_cam) const {
    const double half = 0.5 * options.exposure_time;
    const RigidTransform C0 = (motion.T_world_cam(t - half) * T_left_cam).inverse();
    const RigidTransform C1 = (motion.T_world_cam(t + half) * T_left_cam).inverse();
    const BodyPoses B0 = motion.T_world_body(t - half), B1 = motion.T_world_body(t + half);
    std::vector<Vector6d> twists;
    twists.reserve(scene::kBodies);
    for (std::size_t body = 0; body < scene::kBodies; ++body) {
      twists.push_back(se3_log((C1 * B1[body]) * (C0 * B0[body]).inverse()));
    }
    return twists;
  }

  scene::Exposure exposure(std::size_t index, const RigidTransform& T_left_cam) const {
    scene::Exposure e;
    const bool right = T_left_cam.t.x() != 0.0;
    e.seed = scene::mix(options.seed, right ? 80 : 77, index);  // noise of its own
    e.noise = options.image_noise;
    const double t = time(index);
    if (options.exposure_drift) {
      scene::Random random(options.seed, 78);
      const scene::Wave slow{0.10, 0.07, random.uniform(0.0, 6.28)};
      const scene::Wave quick{0.05, 0.23, random.uniform(0.0, 6.28)};
      e.gain = static_cast<float>(1.0 + slow.at(t) + quick.at(t));
    }
    if (options.motion_blur && options.exposure_time > 0.0)
      e.motion = exposure_motion(t, T_left_cam);
    return e;
  }

  /// Image of a camera at T_left_cam; `work` then holds what its rays met.
  cv::Mat photograph(std::size_t index, const RigidTransform& T_left_cam,
                     scene::Workspace& work) const {
    const RigidTransform T_world_cam = motion.T_world_cam(time(index)) * T_left_cam;
    const BodyPoses bodies = motion.T_world_body(time(index));
    const scene::View seen = view(T_world_cam, bodies);
    const scene::Shader shader(world, room->look(), seen, T_world_cam, bodies, options.movers);
    scene::trace_frame(seen, options.threads, work);
    scene::shade_frame(seen, shader, options.threads, work);
    cv::Mat image;
    scene::expose_frame(world, seen, exposure(index, T_left_cam), options.threads, work, &image);
    return image;
  }

  cv::Mat mask_of(const scene::Workspace& work) const {
    cv::Mat mask(work.height, work.width, CV_8UC1);
    for (int y = 0; y < work.height; ++y) {
      const std::int32_t* from = work.surface.data() + work.at(0, y);
      auto* to = mask.ptr<std::uint8_t>(y);
      for (int x = 0; x < work.width; ++x) {
        to[x] = world.surfaces[static_cast<std::size_t>(from[x])].label;
      }
    }
    return mask;
  }

  static cv::Mat depth_of(const scene::Workspace& work) {
    cv::Mat depth(work.height, work.width, CV_32FC1);
    for (int y = 0; y < work.height; ++y) {
      const float* from = work.w.data() + work.at(0, y);
      auto* to = depth.ptr<float>(y);
      for (int x = 0; x < work.width; ++x) to[x] = 1.0F / from[x];
    }
    return depth;
  }

  int body_of(int surface) const {
    const int solid = world.surfaces[static_cast<std::size_t>(surface)].solid;
    return world.solids[static_cast<std::size_t>(solid)].body;
  }

  /// First meeting of the ray from the camera along `direction` (z = 1 in the camera).
  scene::Hit first_hit(const RigidTransform& T_world_cam, const BodyPoses& bodies,
                       const Eigen::Vector3d& direction) const {
    scene::Hit nearest;
    const Eigen::Vector3d along = T_world_cam.R * direction;
    for (const scene::Solid& solid : world.solids) {
      if (solid.body != 0 && !options.movers) continue;
      const RigidTransform& T_world_body = bodies[static_cast<std::size_t>(solid.body)];
      const scene::Ball ball = scene::ball_around(solid);
      const Eigen::Vector3d way = T_world_body * (solid.T_body_solid * ball.center) - T_world_cam.t;
      const double gap = way.cross(along).squaredNorm() / along.squaredNorm();
      if (gap > 1.001 * ball.radius * ball.radius) continue;
      const RigidTransform T = (T_world_body * solid.T_body_solid).inverse() * T_world_cam;
      const scene::Hit hit = scene::intersect(solid, T.t, T.R * direction);
      if (hit.surface >= 0 && (nearest.surface < 0 || hit.depth < nearest.depth)) nearest = hit;
    }
    return nearest;
  }
};

RenderedScene::RenderedScene(const SceneOptions& options) {
  options.validate();
  impl_ = std::make_unique<Impl>(options, std::make_shared<const Room>(options.seed));
}
RenderedScene::RenderedScene(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

RenderedScene RenderedScene::variant(const SceneOptions& options) const {
  options.validate();
  require(options.seed == impl_->options.seed, "RenderedScene::variant", "seed", options.seed,
          "the seed of the scene, " + std::to_string(impl_->options.seed));
  return RenderedScene(std::make_unique<Impl>(options, impl_->room));
}

RenderedScene::~RenderedScene() = default;
RenderedScene::RenderedScene(RenderedScene&&) noexcept = default;
RenderedScene& RenderedScene::operator=(RenderedScene&&) noexcept = default;

const SceneOptions& RenderedScene::options() const { return impl_->options; }
const DepthCamera& RenderedScene::camera() const { return impl_->options.camera; }
int RenderedScene::surfaces() const { return static_cast<int>(impl_->world.surfaces.size()); }

double RenderedScene::timestamp(std::size_t index) const {
  return impl_->options.start_time + impl_->time(index);
}

std::string RenderedScene::frame_name(std::size_t index) const {
  const int length = std::snprintf(nullptr, 0, "%.6f", timestamp(index));
  std::string name(static_cast<std::size_t>(length), '\0');
  std::snprintf(name.data(), name.size() + 1, "%.6f", timestamp(index));
  return name;
}

RigidTransform RenderedScene::T_world_cam(std::size_t index) const {
  return impl_->motion.T_world_cam(impl_->time(index));
}

RigidTransform RenderedScene::T_world_surface(int surface, std::size_t index) const {
  require(surface >= 0 && surface < surfaces(), "RenderedScene::T_world_surface", "surface",
          surface, "0 to " + std::to_string(surfaces() - 1));
  return impl_->motion.T_world_body(
      impl_->time(index))[static_cast<std::size_t>(impl_->body_of(surface))];
}

Frame RenderedScene::render(std::size_t index) const {
  const Impl& impl = *impl_;
  const SceneOptions& o = impl.options;
  const Impl::Loan loan(impl);
  scene::Workspace& work = *loan;
  const bool stereo = o.stereo_baseline > 0.0;

  Frame frame;
  frame.index = index;
  frame.timestamp = timestamp(index);
  frame.name = frame_name(index);
  frame.T_world_cam = T_world_cam(index);
  if (stereo) {
    const RigidTransform T_left_right(Eigen::Matrix3d::Identity(), {o.stereo_baseline, 0.0, 0.0});
    frame.right = impl.photograph(index, T_left_right, work);
  }
  frame.color = impl.photograph(index, RigidTransform(), work);
  if (!stereo && o.depth_noise) {
    scene::sense_depth(o.camera, scene::mix(o.seed, 79, index), o.threads, work, &frame.depth);
  } else if (!stereo) {
    frame.depth = Impl::depth_of(work);
  }
  frame.mask = impl.mask_of(work);
  return frame;
}

SceneTruth RenderedScene::truth(std::size_t index) const {
  const Impl& impl = *impl_;
  const scene::View view =
      impl.view(T_world_cam(index), impl.motion.T_world_body(impl.time(index)));
  const Impl::Loan loan(impl);
  scene::Workspace& work = *loan;
  scene::trace_frame(view, impl.options.threads, work);
  SceneTruth truth;
  truth.depth = Impl::depth_of(work);
  truth.mask = impl.mask_of(work);
  truth.surface.create(work.height, work.width, CV_16UC1);
  for (int y = 0; y < work.height; ++y) {
    const std::int32_t* from = work.surface.data() + work.at(0, y);
    std::copy_n(from, work.width, truth.surface.ptr<std::uint16_t>(y));
  }
  return truth;
}

cv::Mat RenderedScene::exact_depth(std::size_t index) const { return truth(index).depth; }

std::optional<SurfacePoint> RenderedScene::cast(std::size_t index,
                                                const Eigen::Vector2d& pixel) const {
  if (!pixel.allFinite()) return std::nullopt;
  const Impl& impl = *impl_;
  const RigidTransform T = T_world_cam(index);
  const Eigen::Vector3d direction = camera().bearing(pixel);
  const scene::Hit hit = impl.first_hit(T, impl.motion.T_world_body(impl.time(index)), direction);
  if (hit.surface < 0) return std::nullopt;
  return SurfacePoint{hit.depth, impl.world.surfaces[static_cast<std::size_t>(hit.surface)].label,
                      hit.surface, T * (hit.depth * direction)};
}

std::optional<Correspondence> RenderedScene::correspondence(std::size_t from,
                                                            const Eigen::Vector2d& pixel,
                                                            std::size_t to) const {
  const std::optional<SurfacePoint> point = cast(from, pixel);
  if (!point) return std::nullopt;
  const RigidTransform moved =
      T_world_surface(point->surface, to) * T_world_surface(point->surface, from).inverse();
  const Eigen::Vector3d X = T_world_cam(to).inverse() * (moved * point->in_world);
  if (!PinholeCamera::in_domain(X)) return std::nullopt;
  Correspondence result;
  result.pixel = camera().project(X);
  result.depth = X.z();
  result.label = point->label;
  if (camera().contains(result.pixel)) {
    const std::optional<SurfacePoint> seen = cast(to, result.pixel);
    constexpr double kTolerance = 0.001;  // metres along the ray
    const double stretch = camera().bearing(result.pixel).norm();
    result.visible = seen && (X.z() - seen->depth) * stretch < kTolerance;
  }
  return result;
}

cv::Mat RenderedScene::forward_flow(std::size_t from, std::size_t to) const {
  const SceneTruth here = truth(from);
  const Impl& impl = *impl_;
  const RigidTransform C0 = T_world_cam(from), C1 = T_world_cam(to).inverse();
  const BodyPoses B0 = impl.motion.T_world_body(impl.time(from));
  const BodyPoses B1 = impl.motion.T_world_body(impl.time(to));
  std::vector<RigidTransform> moved;  // camera coordinates of `from` to those of `to`, by body
  for (std::size_t body = 0; body < scene::kBodies; ++body) {
    moved.push_back(C1 * B1[body] * B0[body].inverse() * C0);
  }
  cv::Mat flow(here.depth.size(), CV_32FC2);
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  for (int y = 0; y < flow.rows; ++y) {
    for (int x = 0; x < flow.cols; ++x) {
      const int body = impl.body_of(here.surface.at<std::uint16_t>(y, x));
      const Eigen::Vector2d p(x, y);
      const Eigen::Vector3d X =
          moved[static_cast<std::size_t>(body)] *
          camera().unproject(p, static_cast<double>(here.depth.at<float>(y, x)));
      cv::Vec2f& v = flow.at<cv::Vec2f>(y, x);
      v = {kNaN, kNaN};
      if (!PinholeCamera::in_domain(X)) continue;
      const Eigen::Vector2d d = camera().project(X) - p;
      v = {static_cast<float>(d.x()), static_cast<float>(d.y())};
    }
  }
  return flow;
}

}  // namespace dynslam::dataset
