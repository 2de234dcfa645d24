// A furnished room with people walking through it, rendered with exact truth.
//
// For tests and demonstrations that need no download: every frame comes with the exact pose, depth
// and mask, any two frames with exact correspondences. The picture itself is imperfect in the ways
// of a hand-held depth camera, and every imperfection has a switch.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>

#include "dynslam/core/camera.hpp"
#include "dynslam/core/rigid_transform.hpp"
#include "dynslam/dataset/sequence.hpp"

namespace dynslam::dataset {

/// How the camera moves. All motions are smooth, bounded and go on for ever.
enum class CameraMotion {
  kHandHeld,      ///< wanders 0.2-0.4 m/s, turns 10-30 deg/s, trembles (1-2 mm, 0.2 deg)
  kPureRotation,  ///< turns about its own centre (yaw and pitch); the centre does not move at all
  kForward,       ///< to and fro along the optical axis, no rotation
  kSideways,      ///< to and fro along the camera's x axis, no rotation
  kRound,         ///< round a circle of half a metre, looking outwards; a turn takes 20 s
};

/// Labels in `Frame::mask` of a rendered scene.
inline constexpr std::uint8_t kStaticLabel = 0;
inline constexpr std::uint8_t kPersonLabel = 1;
inline constexpr std::uint8_t kCarriedBoxLabel = 2;

/// Camera of a rendered scene with the field of view of a Kinect: fx = fy = 525 at 640 pixels of
/// width, principal point in the middle, virtual baseline 40 / 525 m.
DepthCamera scene_camera(int width = 640, int height = 480);

/// What to render. All defaults together are the scene "room_walking".
struct SceneOptions {
  std::size_t frames = 600;             ///< length of the sequence, 1 to 1,000,000
  std::uint64_t seed = 1;               ///< room, textures, paths, noise; any number
  double fps = 30.0;                    ///< frames a second, > 0 and at most 1000
  double start_time = 0.0;              ///< seconds, timestamp of frame 0; finite
  DepthCamera camera = scene_camera();  ///< pinhole, each side 16 to 8192 pixels

  CameraMotion motion = CameraMotion::kHandHeld;
  double camera_speed = 1.0;  ///< factor on the camera's velocity (not on the tremor); 0 to 4
  double tremor = 1.0;        ///< factor on the hand's tremor (kHandHeld only); 0 = none, to 10
  bool movers = true;         ///< two people, one of them with a box; off is "room_still"
  double mover_speed = 1.0;   ///< factor on the walking speed (about 0.9 m/s); 0 to 3

  bool motion_blur = true;       ///< blur along the motion during the exposure
  double exposure_time = 0.010;  ///< seconds, the pose is that of its middle; 0 to 1 / fps
  bool exposure_drift = true;    ///< slow gain changes of +-15 %, as automatic exposure makes
  bool image_noise = true;       ///< shot noise and read noise
  bool depth_noise = true;       ///< depth as a structured-light sensor gives it, see `render`
  /// Threads that `render` and `Sequence::read` may start, 1 to 64. The result does not depend on
  /// it.
  int threads = 1;
  /// Metres, 0 to 2. Above 0 the scene is a rectified stereo pair instead of a depth camera: frames
  /// hold the image of a second camera so far to the right and no depth, and `camera.bf` follows.
  double stereo_baseline = 0.0;

  /// Throws InvalidArgument naming the member that breaks its rule.
  void validate() const;
};

/// Exact truth of a frame, without noise, blur and holes.
struct SceneTruth {
  cv::Mat depth;    ///< CV_32FC1, metres along the optical axis at the pixel centres; all > 0
  cv::Mat mask;     ///< CV_8UC1, kStaticLabel, kPersonLabel or kCarriedBoxLabel
  cv::Mat surface;  ///< CV_16UC1, number of the face or body part; the same number in every frame
};

/// What a ray meets first.
struct SurfacePoint {
  double depth = 0.0;        ///< metres along the optical axis
  std::uint8_t label = 0;    ///< as in the mask
  int surface = 0;           ///< as in SceneTruth::surface
  Eigen::Vector3d in_world;  ///< metres
};

/// One point of the scene in two frames.
struct Correspondence {
  Eigen::Vector2d pixel;   ///< in the second frame; may lie outside the image
  double depth = 0.0;      ///< metres, in the second frame; > kMinDepth
  std::uint8_t label = 0;  ///< as in the mask
  bool visible = false;    ///< inside the second image and not hidden there
};

/// The scene itself: renders frames and answers questions about the truth.
///
/// Every frame is a pure function of (options, index): the order of the calls does not matter, and
/// the same program on the same machine gives the same bits. World: metres, z up, floor at z = 0,
/// the middle of the room at x = y = 0. Copies are not made; a scene holds about 20 MB of textures.
///
/// Thread-safety: const members may be called from several threads at once.
class RenderedScene {
 public:
  /// Builds the room (a millisecond; colours are painted by the first `render`, about 0.3 s).
  /// Throws InvalidArgument through `options.validate()`.
  explicit RenderedScene(const SceneOptions& options = {});
  ~RenderedScene();
  RenderedScene(RenderedScene&&) noexcept;
  RenderedScene& operator=(RenderedScene&&) noexcept;

  /// The same room under other options, for example without movers or with another camera. Shares
  /// the textures, so it costs next to nothing. Throws InvalidArgument if the seed is another, or
  /// through `options.validate()`.
  RenderedScene variant(const SceneOptions& options) const;

  const SceneOptions& options() const;
  const DepthCamera& camera() const;

  /// Seconds: start_time + index / fps. Here and below `index` is not limited by options().frames.
  double timestamp(std::size_t index) const;
  /// The timestamp with six decimals, as the files of TUM sequences are named.
  std::string frame_name(std::size_t index) const;
  /// Exact pose of the camera in the middle of the exposure. O(1).
  RigidTransform T_world_cam(std::size_t index) const;
  /// Exact pose of a moving (or still) surface, taking its own coordinates to the world; identity
  /// for what is static. Throws InvalidArgument if there is no such surface. O(1).
  RigidTransform T_world_surface(int surface, std::size_t index) const;
  /// Number of surfaces; SceneTruth::surface is less.
  int surfaces() const;

  /// Renders a frame: colour, depth (or right image), mask, pose.
  ///
  /// Colour: ray casting at the pixel centres, four samples a pixel where surfaces meet, mip-mapped
  /// textures, light from the ceiling, gamma 2.2; blurred along the exact image motion (tiles of 16
  /// pixels, movers and background apart); gain; shot and read noise.
  ///
  /// Depth with `depth_noise`: sigma(z) = 0.0012 + 0.0019 (z - 0.4)^2 metres (Nguyen, Izadi,
  /// Lovell, 3DIMPVT 2012, axial noise at small angles) of which one part is the quantization of
  /// the disparity to 1/8 pixel (baseline 75 mm), the rest normal; none (0) nearer than 0.5 m,
  /// farther than 8 m, at grazing angles, in the projector's shadow left of foreground edges, and
  /// at a few pixels in a thousand. Without it depth is exact and without holes.
  ///
  /// The mask is exact at the pixel centres in the middle of the exposure: it does not grow with
  /// the blur. Allocates its images only.
  Frame render(std::size_t index) const;

  /// Exact depth, labels and surface numbers at the pixel centres. Costs about a third of `render`.
  SceneTruth truth(std::size_t index) const;
  /// truth(index).depth.
  cv::Mat exact_depth(std::size_t index) const;

  /// What the ray through any image point (sub-pixel; also outside the image) meets first, in
  /// double precision and without any acceleration: the oracle for `truth`. Nothing if `pixel` is
  /// not finite. O(objects), a few microseconds.
  std::optional<SurfacePoint> cast(std::size_t index, const Eigen::Vector2d& pixel) const;

  /// Where the point seen at `pixel` in frame `from` is in frame `to`; movers move with their
  /// surface. Nothing if `pixel` is not finite or the point is behind camera `to`. `visible` has a
  /// tolerance of 1 mm along the ray. O(objects).
  std::optional<Correspondence> correspondence(std::size_t from, const Eigen::Vector2d& pixel,
                                               std::size_t to) const;

  /// Exact image motion of every pixel of frame `from` to frame `to`: CV_32FC2, pixels. NaN where
  /// the point is behind camera `to`; points that are hidden there or outside have a value.
  cv::Mat forward_flow(std::size_t from, std::size_t to) const;

 private:
  struct Impl;
  explicit RenderedScene(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Names that `make_scene` knows: "room_walking", "room_still".
std::vector<std::string> scene_names();

/// A rendered scene as a sequence with truth at every frame: SensorKind::kRgbd, or kStereo with a
/// `stereo_baseline`. "room_walking"
/// takes `options` as they are; "room_still" is the same room, light and camera path without
/// movers. Throws InvalidArgument for another name, naming those there are, and through
/// `options.validate()`.
std::unique_ptr<Sequence> make_scene(std::string_view name, const SceneOptions& options = {});

}  // namespace dynslam::dataset
