#include "dynslam/features/matcher.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <string>

#include "dynslam/core/errors.hpp"

#include "features/hamming_kernels.hpp"

namespace dynslam::features {
namespace {

constexpr std::int32_t kNoDistance = std::numeric_limits<std::int32_t>::max();

/// The nearest descriptor met so far and the distance of the next nearest.
struct TwoNearest {
  std::int32_t index = -1;
  std::int32_t distance = kNoDistance;
  std::int32_t second_index = -1;
  std::int32_t second_distance = kNoDistance;

  /// Of equally near ones the lower index is the nearer, in whatever order they come.
  void offer(std::int32_t candidate, std::int32_t candidate_distance) {
    if (nearer(candidate, candidate_distance, index, distance)) {
      second_index = index;
      second_distance = distance;
      index = candidate;
      distance = candidate_distance;
    } else if (nearer(candidate, candidate_distance, second_index, second_distance)) {
      second_index = candidate;
      second_distance = candidate_distance;
    }
  }

  bool passes(int max_distance, float ratio) const {
    if (index < 0 || distance > max_distance) return false;
    return ratio == 1.0F || second_index < 0 ||
           static_cast<float>(distance) < ratio * static_cast<float>(second_distance);
  }

 private:
  static bool nearer(std::int32_t i, std::int32_t distance_i, std::int32_t j,
                     std::int32_t distance_j) {
    return distance_i != distance_j ? distance_i < distance_j : (j < 0 || i < j);
  }
};

void require_ratio(const char* where, float ratio) {
  require(ratio > 0.0F && ratio <= 1.0F, where, "ratio", ratio, "in (0, 1]");
}

// -----------------------------------------------------------------------------------------------
// All against all
// -----------------------------------------------------------------------------------------------

/// Descriptors as 64-bit words without gaps; bytes that a word lacks are 0.
std::vector<std::uint64_t> pack_rows(DescriptorsView descriptors) {
  const std::size_t bytes = static_cast<std::size_t>(descriptors.width);
  const std::size_t words = detail::words_of(bytes);
  std::vector<std::uint64_t> packed(static_cast<std::size_t>(descriptors.height) * words, 0);
  for (int i = 0; i < descriptors.height; ++i) {
    std::memcpy(packed.data() + static_cast<std::size_t>(i) * words, descriptors.row(i), bytes);
  }
  return packed;
}

/// Rows `first` .. `first + rows` of packed descriptors, word by word (see hamming_block).
void transpose_rows(const std::vector<std::uint64_t>& packed, std::size_t words, std::size_t first,
                    std::size_t rows, std::vector<std::uint64_t>& transposed) {
  const std::size_t pitch = detail::padded_rows(rows);
  transposed.assign(words * pitch, 0);
  for (std::size_t t = 0; t < rows; ++t) {
    const std::uint64_t* row = packed.data() + (first + t) * words;
    for (std::size_t w = 0; w < words; ++w) transposed[w * pitch + t] = row[w];
  }
}

std::int32_t key_distance(std::uint32_t key) {
  return static_cast<std::int32_t>(key >> detail::kKeyIndexBits);
}

std::int32_t key_row(std::uint32_t key, std::size_t first) {
  return static_cast<std::int32_t>(first + (key & (detail::kBlockRows - 1)));
}

struct AllNearest {
  std::vector<TwoNearest> of_query;
  std::vector<TwoNearest> of_train;  // empty unless asked for
};

/// Takes both sets block by block; blocks come in ascending order.
AllNearest compare_all(DescriptorsView query, DescriptorsView train, bool both_ways) {
  const std::size_t words = detail::words_of(static_cast<std::size_t>(query.width));
  const std::size_t queries = static_cast<std::size_t>(query.height);
  const std::size_t trains = static_cast<std::size_t>(train.height);
  const std::vector<std::uint64_t> packed_query = pack_rows(query);
  const std::vector<std::uint64_t> packed_train = pack_rows(train);
  AllNearest nearest;
  nearest.of_query.resize(queries);
  if (both_ways) nearest.of_train.resize(trains);

  std::vector<std::uint64_t> transposed;
  std::vector<detail::TwoKeys> keys(std::min(queries, detail::kBlockRows));
  std::vector<std::uint32_t> reverse;
  for (std::size_t t0 = 0; t0 < trains; t0 += detail::kBlockRows) {
    const std::size_t rows = std::min(trains - t0, detail::kBlockRows);
    transpose_rows(packed_train, words, t0, rows, transposed);
    for (std::size_t q0 = 0; q0 < queries; q0 += detail::kBlockRows) {
      const std::size_t count = std::min(queries - q0, detail::kBlockRows);
      if (both_ways) reverse.assign(detail::padded_rows(rows), detail::kNoKey);
      detail::hamming_block(packed_query.data() + q0 * words, count, transposed.data(), rows, words,
                            keys.data(), both_ways ? reverse.data() : nullptr);
      for (std::size_t q = 0; q < count; ++q) {
        for (const std::uint32_t key : {keys[q].best, keys[q].second}) {
          if (key == detail::kNoKey) continue;
          nearest.of_query[q0 + q].offer(key_row(key, t0), key_distance(key));
        }
      }
      for (std::size_t t = 0; both_ways && t < rows; ++t) {
        nearest.of_train[t0 + t].offer(key_row(reverse[t], q0), key_distance(reverse[t]));
      }
    }
  }
  return nearest;
}

// -----------------------------------------------------------------------------------------------
// Windows
// -----------------------------------------------------------------------------------------------

/// Candidates are compared in batches of this many.
constexpr std::size_t kBatch = 64;

class WindowSearch {
 public:
  WindowSearch(const WindowPredictions& predictions, const WindowFeatures& features,
               const WindowOptions& options)
      : predictions_(predictions), features_(features), options_(options) {}

  /// Best feature of prediction i; index -1 if there is none.
  TwoNearest search(std::size_t i) {
    nearest_ = {};
    pending_ = 0;
    const cv::Point2f position = predictions_.positions[i];
    const float radius = predictions_.radii[i];
    if (!(radius > 0.0F) || !std::isfinite(radius) || !std::isfinite(position.x) ||
        !std::isfinite(position.y)) {
      return nearest_;
    }
    query_ = predictions_.descriptors.row(static_cast<int>(i));
    const int min_octave = predictions_.min_octaves.empty() ? kLowest : predictions_.min_octaves[i];
    const int max_octave =
        predictions_.max_octaves.empty() ? kHighest : predictions_.max_octaves[i];
    features_.grid->visit(position, radius, [&](std::int32_t index) {
      const std::size_t feature = static_cast<std::size_t>(index);
      if (!features_.taken.empty() && features_.taken[feature] != 0) return;
      if (!features_.octaves.empty()) {
        const int octave = features_.octaves[feature];
        if (octave < min_octave || octave > max_octave) return;
      }
      candidates_[pending_++] = index;
      if (pending_ == kBatch) flush();
    });
    flush();
    return nearest_;
  }

  bool accepts(const TwoNearest& nearest) const {
    float ratio = options_.ratio;
    if (options_.ratio_within_octave && nearest.second_index >= 0 &&
        features_.octaves[static_cast<std::size_t>(nearest.index)] !=
            features_.octaves[static_cast<std::size_t>(nearest.second_index)]) {
      ratio = 1.0F;
    }
    return nearest.passes(options_.max_distance, ratio);
  }

 private:
  static constexpr int kLowest = std::numeric_limits<int>::min();
  static constexpr int kHighest = std::numeric_limits<int>::max();

  void flush() {
    if (pending_ == 0) return;
    detail::hamming_many(query_, features_.descriptors.data, features_.descriptors.stride_bytes,
                         static_cast<std::size_t>(features_.descriptors.width), candidates_,
                         pending_, distances_);
    for (std::size_t i = 0; i < pending_; ++i) nearest_.offer(candidates_[i], distances_[i]);
    pending_ = 0;
  }

  const WindowPredictions& predictions_;
  const WindowFeatures& features_;
  const WindowOptions& options_;
  const std::uint8_t* query_ = nullptr;
  TwoNearest nearest_;
  std::size_t pending_ = 0;
  std::int32_t candidates_[kBatch];
  std::int32_t distances_[kBatch];
};

/// Keeps of each feature's matches the nearest, of equally near ones that of the first prediction.
void resolve_one_to_one(std::vector<Match>& matches) {
  std::sort(matches.begin(), matches.end(), [](const Match& a, const Match& b) {
    if (a.train != b.train) return a.train < b.train;
    if (a.distance != b.distance) return a.distance < b.distance;
    return a.query < b.query;
  });
  const auto same_train = [](const Match& a, const Match& b) { return a.train == b.train; };
  matches.erase(std::unique(matches.begin(), matches.end(), same_train), matches.end());
  std::sort(matches.begin(), matches.end(),
            [](const Match& a, const Match& b) { return a.query < b.query; });
}

std::size_t rows_of(DescriptorsView descriptors) {
  return descriptors.empty() ? 0 : static_cast<std::size_t>(descriptors.height);
}

void require_size(const char* parameter, std::size_t size, std::size_t expected) {
  require(size == expected, "match_windowed", parameter, size, expected);
}

void require_consistent(const WindowPredictions& predictions, const WindowFeatures& features,
                        const WindowOptions& options) {
  const std::size_t p = predictions.positions.size();
  require_size("predictions.radii.size()", predictions.radii.size(), p);
  require_size("predictions.descriptors.height", rows_of(predictions.descriptors), p);
  const bool bounded = !predictions.min_octaves.empty() || !predictions.max_octaves.empty();
  if (!predictions.min_octaves.empty()) {
    require_size("predictions.min_octaves.size()", predictions.min_octaves.size(), p);
  }
  if (!predictions.max_octaves.empty()) {
    require_size("predictions.max_octaves.size()", predictions.max_octaves.size(), p);
  }

  const std::size_t n = rows_of(features.descriptors);
  require(features.grid != nullptr, "match_windowed", "features.grid", "nullptr", "a grid");
  require_size("features.grid->size()", features.grid->size(), n);
  if (bounded || options.ratio_within_octave || !features.octaves.empty()) {
    require_size("features.octaves.size()", features.octaves.size(), n);
  }
  if (!features.taken.empty()) require_size("features.taken.size()", features.taken.size(), n);
  if (p > 0 && n > 0) {
    require(predictions.descriptors.width == features.descriptors.width, "match_windowed",
            "predictions.descriptors.width", predictions.descriptors.width,
            features.descriptors.width);
  }
}

}  // namespace

void BruteForceOptions::validate() const {
  constexpr const char* where = "BruteForceOptions::validate";
  require(max_distance >= 0, where, "max_distance", max_distance, ">= 0");
  require_ratio(where, ratio);
}

void match_brute_force(DescriptorsView query, DescriptorsView train,
                       const BruteForceOptions& options, std::vector<Match>& matches) {
  constexpr const char* where = "match_brute_force";
  options.validate();
  if (query.empty() || train.empty()) {
    matches.clear();
    return;
  }
  require(query.width == train.width, where, "query.width", query.width, train.width);
  if (static_cast<std::size_t>(query.width) > detail::kMaxKeyBytes) {
    throw_invalid_argument(where, "query.width", query.width,
                           "at most " + std::to_string(detail::kMaxKeyBytes) + " bytes");
  }

  const AllNearest nearest = compare_all(query, train, options.cross_check);
  matches.clear();
  for (std::size_t q = 0; q < nearest.of_query.size(); ++q) {
    const TwoNearest& two = nearest.of_query[q];
    if (!two.passes(options.max_distance, options.ratio)) continue;
    const std::int32_t index = static_cast<std::int32_t>(q);
    if (options.cross_check &&
        nearest.of_train[static_cast<std::size_t>(two.index)].index != index) {
      continue;
    }
    matches.push_back({index, two.index, static_cast<float>(two.distance)});
  }
}

void WindowOptions::validate() const {
  constexpr const char* where = "WindowOptions::validate";
  require(max_distance >= 0, where, "max_distance", max_distance, ">= 0");
  require_ratio(where, ratio);
}

void match_windowed(const WindowPredictions& predictions, const WindowFeatures& features,
                    const WindowOptions& options, std::vector<Match>& matches) {
  options.validate();
  require_consistent(predictions, features, options);
  matches.clear();
  WindowSearch window(predictions, features, options);
  for (std::size_t i = 0; i < predictions.positions.size(); ++i) {
    const TwoNearest nearest = window.search(i);
    if (!window.accepts(nearest)) continue;
    matches.push_back(
        {static_cast<std::int32_t>(i), nearest.index, static_cast<float>(nearest.distance)});
  }
  if (options.one_to_one) resolve_one_to_one(matches);
}

}  // namespace dynslam::features
