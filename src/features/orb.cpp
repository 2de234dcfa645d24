#include "dynslam/features/orb.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <string>

#include <opencv2/core.hpp>

#include "dynslam/core/errors.hpp"

#include "features/orb_kernels.hpp"
#include "features/orb_reference.hpp"
#include "features/orb_spread.hpp"

namespace dynslam::features {
namespace {

using detail::Corner;

/// Widest and highest image: corners are stored in 16 bits.
constexpr int kMaxSide = 65535;

/// Bytes before the first row and after the last.
constexpr std::size_t kSlackAround = std::size_t{2} * detail::kRowSlack;

/// A level with the slack that the kernels ask for.
struct LevelImage {
  std::vector<std::uint8_t> bytes;
  std::ptrdiff_t stride = 0;
  int width = 0;
  int height = 0;

  void resize(int new_width, int new_height) {
    width = new_width;
    height = new_height;
    stride = (std::ptrdiff_t{new_width} + detail::kRowSlack + 63) / 64 * 64;
    bytes.resize(static_cast<std::size_t>(stride * new_height) + kSlackAround);
  }
  detail::MutablePixelBlock block() {
    return {bytes.data() + detail::kRowSlack, stride, width, height};
  }
  detail::PixelBlock view() const {
    return {bytes.data() + detail::kRowSlack, stride, width, height};
  }
};

/// How the pixels of a level lie between those of the level below, along one axis.
struct AxisTable {
  std::vector<std::int32_t> first;
  std::vector<std::uint16_t> weight;

  void fill(int source_size, int target_size, double step) {
    first.resize(static_cast<std::size_t>(target_size));
    weight.resize(static_cast<std::size_t>(target_size));
    for (std::size_t i = 0; i < first.size(); ++i) {
      const double at = std::clamp((static_cast<double>(i) + 0.5) * step - 0.5, 0.0,
                                   static_cast<double>(source_size - 1));
      const int pixel = std::min(static_cast<int>(at), source_size - 2);
      first[i] = pixel;
      weight[i] = static_cast<std::uint16_t>(std::lround((at - pixel) * 256.0));
    }
  }
  detail::ResizeAxis axis() const { return {first.data(), weight.data()}; }
};

struct Level {
  LevelImage image;
  LevelImage blurred;
  AxisTable columns, rows;
  std::vector<Corner> corners, crowd;  // elsewhere and there
  std::vector<Corner> chosen;
};

detail::Rotation rotation_of(float angle_degrees) {
  const float angle = angle_degrees * static_cast<float>(CV_PI / 180.0);
  return {static_cast<float>(std::cos(angle)), static_cast<float>(std::sin(angle))};
}

std::string size_text(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

bool is_inside(const detail::PixelBlock& level, int x, int y) {
  return x >= kOrbBorder && y >= kOrbBorder && x < level.width - kOrbBorder &&
         y < level.height - kOrbBorder;
}

}  // namespace

void OrbOptions::validate() const {
  constexpr const char* where = "OrbOptions::validate";
  require(max_features >= 1, where, "max_features", max_features, ">= 1");
  require(scale_factor > 1.0F && scale_factor <= 4.0F, where, "scale_factor", scale_factor,
          "> 1 and <= 4");
  require(levels >= 1 && levels <= 32, where, "levels", levels, "1..32");
  require(fast_threshold >= 1 && fast_threshold <= 254, where, "fast_threshold", fast_threshold,
          "1..254");
  require(min_fast_threshold >= 1 && min_fast_threshold <= fast_threshold, where,
          "min_fast_threshold", min_fast_threshold, "1..fast_threshold");
  require(spread >= 0.0F && spread <= 1.0F, where, "spread", spread, "0..1");
  require(cell_size >= 8, where, "cell_size", cell_size, ">= 8");
  require(mask_margin >= 0 && mask_margin <= 1024, where, "mask_margin", mask_margin, "0..1024");
}

struct OrbExtractor::Impl {
  OrbOptions options;
  std::vector<float> scales;
  std::vector<int> shares;

  std::vector<Level> levels;  // as many as this image has
  int width = 0;              // of the image that the levels are laid out for
  int height = 0;
  detail::MaskProbe mask, crowd;
  detail::CornerChooser chooser;
  std::vector<Corner> corners;
  std::vector<std::uint8_t> scores;
  std::vector<std::uint16_t> sums;
  std::vector<int> asked, available, take;
  std::vector<std::int32_t> m10, m01;
  std::vector<detail::Rotation> rotations;

  explicit Impl(const OrbOptions& given) : options(given) {
    options.validate();
    const double factor = static_cast<double>(options.scale_factor);
    for (int i = 0; i < options.levels; ++i)
      scales.push_back(static_cast<float>(std::pow(factor, i)));
    share_features(options.max_features, shares);
  }

  /// Shares proportional to 1 / scale: the number of corners of a given strength that a level holds
  /// falls about as its side, not as its area. Rounded so that they sum to `budget`.
  void share_features(int budget, std::vector<int>& parts) const {
    double sum = 0.0;
    for (const float scale : scales) sum += 1.0 / static_cast<double>(scale);
    double wanted = 0.0;
    int given = 0;
    parts.clear();
    for (const float scale : scales) {
      wanted += budget / (static_cast<double>(scale) * sum);
      const int upto = std::min(static_cast<int>(std::lround(wanted)), budget);
      parts.push_back(upto - given);
      given = upto;
    }
    parts.back() += budget - given;
  }

  void lay_out(int new_width, int new_height) {
    if (new_width == width && new_height == height) return;
    // Forgotten first, so that a failed allocation cannot leave half of a layout behind.
    width = 0;
    height = 0;
    std::size_t count = 0;
    for (const float scale : scales) {
      const int level_width = static_cast<int>(std::lround(static_cast<float>(new_width) / scale));
      const int level_height =
          static_cast<int>(std::lround(static_cast<float>(new_height) / scale));
      if (std::min(level_width, level_height) <= 2 * kOrbBorder) break;
      if (levels.size() <= count) levels.emplace_back();
      Level& level = levels[count];
      level.image.resize(level_width, level_height);
      level.blurred.resize(level_width, level_height);
      if (count > 0) {
        const LevelImage& below = levels[count - 1].image;
        const double step = static_cast<double>(options.scale_factor);
        level.columns.fill(below.width, level_width, step);
        level.rows.fill(below.height, level_height, step);
      }
      ++count;
    }
    levels.resize(count);
    if (count > 0) {
      const LevelImage& first = levels[0].image;
      corners.resize(static_cast<std::size_t>((first.width + 1) / 2) *
                     static_cast<std::size_t>((first.height + 1) / 2));
      scores.resize(3 * static_cast<std::size_t>(first.stride));
      sums.resize(static_cast<std::size_t>(first.width) + kSlackAround);
    }
    width = new_width;
    height = new_height;
  }

  void build_pyramid(GrayView image) {
    lay_out(image.width, image.height);
    for (std::size_t i = 0; i < levels.size(); ++i) {
      Level& level = levels[i];
      const detail::MutablePixelBlock target = level.image.block();
      if (i == 0) {
        for (int y = 0; y < image.height; ++y) {
          std::memcpy(target.row(y), image.row(y), static_cast<std::size_t>(image.width));
        }
      } else {
        detail::resize_level(levels[i - 1].image.view(), level.columns.axis(), level.rows.axis(),
                             target, sums.data());
      }
    }
  }

  void find_corners(Level& level, float scale) {
    const detail::PixelBlock image = level.image.view();
    int count = detail::fast_corners(image, kOrbBorder, options.min_fast_threshold, scores.data(),
                                     corners.data());
    if (!options.subpixel) {
      for (int i = 0; i < count; ++i) {
        Corner& corner = corners[static_cast<std::size_t>(i)];
        corner.dx = corner.dy = 0;
      }
    }
    if (!mask.empty()) {
      count = detail::CornerChooser::drop_masked(mask, scale, corners.data(), count);
    }
    if (options.min_fast_threshold < options.fast_threshold) {
      count = chooser.drop_weak(options.cell_size, options.fast_threshold, image, corners.data(),
                                count);
    }
    level.crowd.clear();
    if (crowd.empty()) {
      level.corners.assign(corners.begin(), corners.begin() + count);
      return;
    }
    level.corners.clear();
    for (int i = 0; i < count; ++i) {
      const Corner& corner = corners[static_cast<std::size_t>(i)];
      const bool there = detail::CornerChooser::is_covered(crowd, scale, corner);
      (there ? level.crowd : level.corners).push_back(corner);
    }
  }

  /// Adds those of one of two lists of every level's corners that a budget chooses; returns their
  /// number.
  int choose_from(std::vector<Corner> Level::*list, int budget) {
    share_features(budget, asked);
    available.assign(asked.size(), 0);
    for (std::size_t i = 0; i < levels.size(); ++i) {
      available[i] = static_cast<int>((levels[i].*list).size());
    }
    detail::divide_budget(asked, available, budget, take);
    int count = 0;
    for (std::size_t i = 0; i < levels.size(); ++i) {
      count += chooser.spread(levels[i].*list, take[i], options.spread, levels[i].chosen);
    }
    return count;
  }

  /// Chooses the corners of every level; returns their number.
  int choose_corners(const OrbBudget& budget) {
    for (std::size_t i = 0; i < levels.size(); ++i) {
      find_corners(levels[i], scales[i]);
      levels[i].chosen.clear();
    }
    const int elsewhere = choose_from(&Level::corners, budget.max_features);
    if (crowd.empty()) return elsewhere;
    return elsewhere + choose_from(&Level::crowd, budget.max_in_crowd);
  }

  /// Key points and descriptors of the chosen corners of a level.
  void describe_chosen(std::size_t index, cv::KeyPoint* keypoints, std::uint8_t* descriptors) {
    Level& level = levels[index];
    const std::size_t count = level.chosen.size();
    if (count == 0) return;
    const int n = static_cast<int>(count);
    m10.resize(count);
    m01.resize(count);
    rotations.resize(count);
    detail::patch_moments(level.image.view(), level.chosen.data(), n, m10.data(), m01.data());
    const float scale = scales[index];
    for (std::size_t i = 0; i < count; ++i) {
      const Corner& corner = level.chosen[i];
      // OpenCV's approximation of the arc tangent is part of what its descriptors are.
      const float angle = cv::fastAtan2(static_cast<float>(m01[i]), static_cast<float>(m10[i]));
      keypoints[i] = cv::KeyPoint(detail::level0_coordinate(corner.x, corner.dx, scale),
                                  detail::level0_coordinate(corner.y, corner.dy, scale),
                                  static_cast<float>(kOrbPatchSize) * scale, angle,
                                  static_cast<float>(corner.score), static_cast<int>(index), -1);
      rotations[i] = rotation_of(angle);
    }
    detail::blur_level(level.image.view(), level.blurred.block(), sums.data());
    detail::rotated_brief(level.blurred.view(), level.chosen.data(), rotations.data(), n,
                          descriptors);
  }

  void require_describable(const cv::KeyPoint& keypoint) const {
    constexpr const char* where = "OrbExtractor::describe";
    require(std::isfinite(keypoint.angle), where, "keypoints[i].angle", keypoint.angle, "finite");
    const bool inside = keypoint.pt.x >= -0.5F && keypoint.pt.y >= -0.5F &&
                        keypoint.pt.x < static_cast<float>(width) - 0.5F &&
                        keypoint.pt.y < static_cast<float>(height) - 0.5F;
    if (!inside) {
      throw_invalid_argument(
          where, "keypoints[i].pt",
          "(" + std::to_string(keypoint.pt.x) + ", " + std::to_string(keypoint.pt.y) + ")",
          "a position inside the image, " + size_text(width, height));
    }
    if (keypoint.octave < 0 || static_cast<std::size_t>(keypoint.octave) >= levels.size()) {
      throw_invalid_argument(
          where, "keypoints[i].octave", keypoint.octave,
          "less than the " + std::to_string(levels.size()) + " levels of the image's pyramid");
    }
  }

  void describe_one(const cv::KeyPoint& keypoint, std::uint8_t* descriptor) const {
    const std::size_t octave = static_cast<std::size_t>(keypoint.octave);
    const detail::PixelBlock level = levels[octave].blurred.view();
    const float scale = scales[octave];
    const int x = std::clamp(detail::level_pixel(keypoint.pt.x, scale), 0, level.width - 1);
    const int y = std::clamp(detail::level_pixel(keypoint.pt.y, scale), 0, level.height - 1);
    const detail::Rotation rotation = rotation_of(keypoint.angle);
    if (is_inside(level, x, y)) {
      const Corner corner = {static_cast<std::uint16_t>(x), static_cast<std::uint16_t>(y), 0};
      detail::rotated_brief(level, &corner, &rotation, 1, descriptor);
      return;
    }
    const auto nearest_pixel = [&](int dx, int dy) {
      return level.row(
          std::clamp(y + dy, 0, level.height - 1))[std::clamp(x + dx, 0, level.width - 1)];
    };
    detail::reference::describe_patch(rotation, nearest_pixel, descriptor);
  }
};

OrbExtractor::OrbExtractor(const OrbOptions& options) : impl_(std::make_unique<Impl>(options)) {}
OrbExtractor::~OrbExtractor() = default;
OrbExtractor::OrbExtractor(OrbExtractor&&) noexcept = default;
OrbExtractor& OrbExtractor::operator=(OrbExtractor&&) noexcept = default;

namespace {

void require_image(const char* where, GrayView image) {
  require(!image.empty(), where, "image", "an empty image", "at least one pixel");
  if (image.width > kMaxSide || image.height > kMaxSide) {
    throw_invalid_argument(where, "image size", size_text(image.width, image.height),
                           "sides of at most " + std::to_string(kMaxSide) + " pixels");
  }
}

void require_size_of(const char* where, const char* name, MaskView mask, GrayView image) {
  if (mask.empty() || mask.same_size(image)) return;
  throw_invalid_argument(where, std::string(name) + " size", size_text(mask.width, mask.height),
                         "the image's, " + size_text(image.width, image.height));
}

/// Rows without gaps, whatever part of whatever matrix `descriptors` was.
void allocate(cv::Mat& descriptors, int rows) {
  if (!descriptors.isContinuous()) descriptors.release();
  descriptors.create(rows, kOrbDescriptorBytes, CV_8UC1);
}

}  // namespace

void OrbExtractor::extract(GrayView image, MaskView mask, std::vector<cv::KeyPoint>& keypoints,
                           cv::Mat& descriptors) {
  extract(image, mask, {impl_->options.max_features, {}, 0}, keypoints, descriptors);
}

void OrbExtractor::extract(GrayView image, MaskView mask, const OrbBudget& budget,
                           std::vector<cv::KeyPoint>& keypoints, cv::Mat& descriptors) {
  constexpr const char* where = "OrbExtractor::extract";
  require_image(where, image);
  require_size_of(where, "mask", mask, image);
  require_size_of(where, "crowd", budget.crowd, image);
  require(budget.max_features >= 1, where, "max_features", budget.max_features, ">= 1");
  require(budget.max_in_crowd >= 0, where, "max_in_crowd", budget.max_in_crowd, ">= 0");

  Impl& impl = *impl_;
  impl.build_pyramid(image);
  impl.mask.reset(mask, impl.options.mask_margin);
  impl.crowd.reset(budget.crowd, 0);
  const int count = impl.choose_corners(budget);
  impl.mask.reset({}, 0);
  impl.crowd.reset({}, 0);
  keypoints.resize(static_cast<std::size_t>(count));
  if (count == 0) {
    descriptors.release();
    return;
  }
  allocate(descriptors, count);
  std::size_t at = 0;
  for (std::size_t i = 0; i < impl.levels.size(); ++i) {
    impl.describe_chosen(i, keypoints.data() + at, descriptors.ptr(static_cast<int>(at)));
    at += impl.levels[i].chosen.size();
  }
}

void OrbExtractor::describe(GrayView image, Span<const cv::KeyPoint> keypoints,
                            cv::Mat& descriptors) {
  require_image("OrbExtractor::describe", image);
  Impl& impl = *impl_;
  impl.lay_out(image.width, image.height);
  for (const cv::KeyPoint& keypoint : keypoints) impl.require_describable(keypoint);
  if (keypoints.empty()) {
    descriptors.release();
    return;
  }
  impl.build_pyramid(image);
  std::vector<bool> wanted(impl.levels.size(), false);
  for (const cv::KeyPoint& keypoint : keypoints) {
    wanted[static_cast<std::size_t>(keypoint.octave)] = true;
  }
  for (std::size_t i = 0; i < impl.levels.size(); ++i) {
    Level& level = impl.levels[i];
    if (wanted[i]) {
      detail::blur_level(level.image.view(), level.blurred.block(), impl.sums.data());
    }
  }
  allocate(descriptors, static_cast<int>(keypoints.size()));
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    impl.describe_one(keypoints[i], descriptors.ptr(static_cast<int>(i)));
  }
}

GrayView OrbExtractor::level(int octave) const {
  if (octave < 0 || static_cast<std::size_t>(octave) >= impl_->levels.size()) return {};
  const detail::PixelBlock view = impl_->levels[static_cast<std::size_t>(octave)].image.view();
  return {view.data, view.width, view.height, view.stride};
}

const std::vector<float>& OrbExtractor::scale_factors() const { return impl_->scales; }
const std::vector<int>& OrbExtractor::features_per_level() const { return impl_->shares; }
const OrbOptions& OrbExtractor::options() const { return impl_->options; }

}  // namespace dynslam::features
