#include "scene_frame.hpp"

#include <algorithm>
#include <exception>
#include <thread>

namespace dynslam::dataset::scene {

void in_parallel(int threads, int count, const std::function<void(int, int, int)>& work) {
  if (threads <= 1 || count <= 1) {
    work(0, count, 0);
    return;
  }
  threads = std::min(threads, count);
  std::vector<std::exception_ptr> errors(static_cast<std::size_t>(threads));
  const auto run = [&](int thread) {
    try {
      work(count * thread / threads, count * (thread + 1) / threads, thread);
    } catch (...) {
      errors[static_cast<std::size_t>(thread)] = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  others.reserve(static_cast<std::size_t>(threads - 1));
  for (int thread = 1; thread < threads; ++thread) others.emplace_back(run, thread);
  run(0);
  for (std::thread& other : others) other.join();
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

void Workspace::prepare(int width_, int height_, int threads_) {
  while (threads.size() < static_cast<std::size_t>(threads_)) {
    threads.push_back(std::make_unique<Thread>());
  }
  if (width == width_ && height == height_) return;
  width = width_;
  height = height_;
  columns = (width + kTile - 1) / kTile;
  rows = (height + kTile - 1) / kTile;
  stride = columns * kTile;
  color_stride = stride + 2 * kBorder;
  const auto pixels = static_cast<std::size_t>(stride * rows * kTile);
  w.assign(pixels, 0.0F);
  surface.assign(pixels, 0);
  color.assign(static_cast<std::size_t>(color_stride * (rows * kTile + 2 * kBorder)), 0U);
  candidates.resize(static_cast<std::size_t>(columns * rows));
}

void trace_frame(const View& view, int threads, Workspace& work) {
  in_parallel(threads, work.rows, [&](int first, int last, int thread) {
    Samples& samples = work.threads[static_cast<std::size_t>(thread)]->samples;
    for (int row = first; row < last; ++row) {
      for (int column = 0; column < work.columns; ++column) {
        const int x = column * kTile, y = row * kTile;
        std::vector<int>& list =
            work.candidates[static_cast<std::size_t>(row * work.columns + column)];
        view.candidates(x, y, list);
        place_pixels(x, y, samples);
        view.trace(list, samples);
        for (int line = 0; line < kTile; ++line) {
          const std::size_t to = work.at(x, y + line);
          std::copy_n(samples.w + line * kTile, kTile, work.w.data() + to);
          std::copy_n(samples.surface + line * kTile, kTile, work.surface.data() + to);
        }
      }
    }
  });
}

namespace {

constexpr int kSubsamples = 4;
/// A rotated grid: edges of any direction pass its points one by one.
constexpr float kSubX[kSubsamples] = {-0.125F, 0.375F, -0.375F, 0.125F};
constexpr float kSubY[kSubsamples] = {-0.375F, -0.125F, 0.125F, 0.375F};

/// Pixels of a tile next to which another surface is seen.
void find_edges(const Workspace& work, int x0, int y0, std::vector<int>& edges) {
  edges.clear();
  const int right = work.stride - 1, bottom = work.rows * kTile - 1;
  for (int y = 0; y < kTile; ++y) {
    const std::int32_t* line = work.surface.data() + work.at(0, y0 + y);
    const std::int32_t* above = work.surface.data() + work.at(0, std::max(0, y0 + y - 1));
    const std::int32_t* below = work.surface.data() + work.at(0, std::min(bottom, y0 + y + 1));
    for (int x = 0; x < kTile; ++x) {
      const int c = x0 + x;
      const std::int32_t s = line[c];
      const int left = std::max(0, c - 1), after = std::min(right, c + 1);
      const bool edge = line[left] != s || line[after] != s || above[c] != s || below[c] != s;
      if (edge) edges.push_back(y * kTile + x);
    }
  }
}

/// Samples the edge pixels of the tile in `thread.samples` more finely and mixes the results.
void smooth_edges(const View& view, const Shader& shader, const std::vector<int>& candidates,
                  Workspace::Thread& thread, std::uint32_t* tile) {
  Samples& samples = thread.samples;
  samples.count = static_cast<int>(thread.edges.size()) * kSubsamples;
  for (std::size_t e = 0; e < thread.edges.size(); ++e) {
    const int pixel = thread.edges[e];
    for (std::size_t k = 0; k < kSubsamples; ++k) {
      const std::size_t i = e * kSubsamples + k;
      samples.dx[i] = static_cast<float>(pixel % kTile) - 0.5F * (kTile - 1) + kSubX[k];
      samples.dy[i] = static_cast<float>(pixel / kTile) - 0.5F * (kTile - 1) + kSubY[k];
    }
  }
  view.trace(candidates, samples);
  shader.shade(samples, thread.shading, thread.shaded);
  for (std::size_t e = 0; e < thread.edges.size(); ++e) {
    std::uint32_t even = 0x00020002U, odd = 0x00020002U;
    for (std::size_t k = 0; k < kSubsamples; ++k) {
      const std::uint32_t c = thread.shaded[e * kSubsamples + k];
      even += c & kEvenBytes;
      odd += (c >> 8) & kEvenBytes;
    }
    tile[thread.edges[e]] = ((even >> 2) & kEvenBytes) | (((odd >> 2) & kEvenBytes) << 8);
  }
}

/// Repeats the outermost pixels of the image into the borders.
void extend_borders(Workspace& work) {
  const int w = work.width, h = work.height;
  for (int y = 0; y < h; ++y) {
    std::uint32_t* line = work.color.data() + work.color_at(0, y);
    std::fill(line - kBorder, line, line[0]);
    std::fill(line + w, line + work.stride + kBorder, line[w - 1]);
  }
  const auto stride = static_cast<std::size_t>(work.color_stride);
  for (int y = 1; y <= kBorder; ++y) {
    std::copy_n(work.color.data() + work.color_at(-kBorder, 0), stride,
                work.color.data() + work.color_at(-kBorder, -y));
  }
  for (int y = h; y < work.rows * kTile + kBorder; ++y) {
    std::copy_n(work.color.data() + work.color_at(-kBorder, h - 1), stride,
                work.color.data() + work.color_at(-kBorder, y));
  }
}

}  // namespace

void shade_frame(const View& view, const Shader& shader, int threads, Workspace& work) {
  in_parallel(threads, work.rows, [&](int first, int last, int thread_index) {
    Workspace::Thread& thread = *work.threads[static_cast<std::size_t>(thread_index)];
    Samples& samples = thread.samples;
    std::uint32_t tile[kTilePixels];
    for (int row = first; row < last; ++row) {
      for (int column = 0; column < work.columns; ++column) {
        const int x = column * kTile, y = row * kTile;
        place_pixels(x, y, samples);
        for (int line = 0; line < kTile; ++line) {
          const std::size_t from = work.at(x, y + line);
          std::copy_n(work.w.data() + from, kTile, samples.w + line * kTile);
          std::copy_n(work.surface.data() + from, kTile, samples.surface + line * kTile);
        }
        shader.shade(samples, thread.shading, tile);
        find_edges(work, x, y, thread.edges);
        if (!thread.edges.empty()) {
          const auto index = static_cast<std::size_t>(row * work.columns + column);
          smooth_edges(view, shader, work.candidates[index], thread, tile);
        }
        for (int line = 0; line < kTile; ++line) {
          std::copy_n(tile + line * kTile, kTile, work.color.data() + work.color_at(x, y + line));
        }
      }
    }
  });
  extend_borders(work);
}

}  // namespace dynslam::dataset::scene
