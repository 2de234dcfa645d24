// From a view to the images of a frame.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <opencv2/core/mat.hpp>

#include "scene_shade.hpp"
#include "scene_trace.hpp"
#include "scene_world.hpp"

namespace dynslam::dataset::scene {

/// Runs work(first, last, thread) on parts of [0, count) in `threads` threads, one of them the
/// caller's. Exceptions of the work end up with the caller.
void in_parallel(int threads, int count, const std::function<void(int, int, int)>& work);

/// Pixels that colours are known beyond each edge of the image, so that blur needs no test.
inline constexpr int kBorder = kTile;

/// Memory of one frame in the making; reused for the next.
struct Workspace {
  /// For images of this size and that many threads.
  void prepare(int width, int height, int threads);

  int width = 0, height = 0;  ///< of the image
  int columns = 0, rows = 0;  ///< tiles
  int stride = 0;             ///< of w and surface, whole tiles
  int color_stride = 0;       ///< of color, with borders
  std::vector<float> w;       ///< 1 / depth, exact
  std::vector<std::int32_t> surface;
  std::vector<std::uint32_t> color;          ///< B, G, R, 255
  std::vector<std::vector<int>> candidates;  ///< of every tile
  struct Thread {
    Samples samples;
    Shader::Scratch shading;
    std::uint32_t shaded[kMaxSamples];
    std::vector<int> edges;  ///< pixels of the tile that need more samples
  };
  std::vector<std::unique_ptr<Thread>> threads;

  std::size_t at(int x, int y) const { return static_cast<std::size_t>(y * stride + x); }
  std::size_t color_at(int x, int y) const {
    return static_cast<std::size_t>((y + kBorder) * color_stride + x + kBorder);
  }
};

/// Fills `w`, `surface` and `candidates`.
void trace_frame(const View& view, int threads, Workspace& work);

/// Fills `color` from a traced frame: one sample in the middle of a pixel, four more where a
/// neighbour shows another surface.
void shade_frame(const View& view, const Shader& shader, int threads, Workspace& work);

/// What the imperfections of a frame depend on.
struct Exposure {
  std::uint64_t seed = 0;  ///< of this frame's noise
  float gain = 1.0F;       ///< of the light
  bool noise = true;
  /// Motion of every body in the camera's coordinates during the exposure (twist rho, omega), empty
  /// without blur.
  std::vector<Vector6d> motion;
};

/// Blur, gain and noise: `color` becomes the image, CV_8UC3.
void expose_frame(const World& world, const View& view, const Exposure& exposure, int threads,
                  Workspace& work, cv::Mat* image);

/// Depth as a structured-light sensor measures it, CV_32FC1; see RenderedScene::render.
void sense_depth(const PinholeCamera& camera, std::uint64_t seed, int threads,
                 const Workspace& work, cv::Mat* depth);

/// Normal deviates in units of 1/32, 16 bits of address plus room to read on.
class NoiseTable {
 public:
  static const NoiseTable& get();
  const std::int8_t* from(std::uint64_t hash) const { return values_.data() + (hash & 0xFFFFU); }

 private:
  NoiseTable();
  std::vector<std::int8_t> values_;
};
inline constexpr float kNoiseUnit = 1.0F / 32.0F;

}  // namespace dynslam::dataset::scene
