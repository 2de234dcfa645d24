#include "dynslam/loop/vocabulary_training.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <string>
#include <vector>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/majority.hpp"
#include "loop/parallel.hpp"
#include "loop/walk_kernels.hpp"

namespace dynslam::loop {
namespace {

constexpr std::size_t kPiece = 1U << 15;  // rows that one thread takes at a time

/// NodeRandom numbers of a node: the same whoever splits it, and when.
class NodeRandom {
 public:
  NodeRandom(std::uint64_t seed, std::uint64_t node)
      : state_(seed ^ (node + 1) * 0x9E3779B97F4A7C15U) {
    next();
  }
  /// SplitMix64 (Steele, Lea & Flood 2014).
  std::uint64_t next() {
    std::uint64_t v = (state_ += 0x9E3779B97F4A7C15U);
    v = (v ^ (v >> 30)) * 0xBF58476D1CE4E5B9U;
    v = (v ^ (v >> 27)) * 0x94D049BB133111EBU;
    return v ^ (v >> 31);
  }
  /// Below `end`, which is at most 2^53 or so; the bias is less than end / 2^64.
  std::uint64_t below(std::uint64_t end) { return next() % end; }

 private:
  std::uint64_t state_;
};

/// Descriptors as 64-bit words without gaps.
struct Samples {
  std::vector<std::uint64_t> bits;
  std::size_t words = 0;  // of a descriptor
  std::size_t count = 0;
  const std::uint64_t* at(std::uint32_t row) const { return bits.data() + row * words; }
  bool equal(std::uint32_t a, std::uint32_t b) const {
    return std::memcmp(at(a), at(b), words * 8) == 0;
  }
};

/// A node on its way: rows[begin, end) of the order belong to it.
struct Node {
  std::uint32_t parent = 0;  // row of the tree
  std::size_t begin = 0;
  std::size_t end = 0;
  std::size_t size() const { return end - begin; }
};

/// Children that a node was split into.
struct Split {
  std::vector<std::uint64_t> centres;  // words of each
  std::vector<std::size_t> ends;       // of their rows, within the node's
};

class Trainer {
 public:
  Trainer(const Samples& samples, int descriptor_bytes, const TrainingOptions& options)
      : samples_(samples), options_(options), rows_(samples.count), nearest_(samples.count) {
    for (std::uint32_t row = 0; row < rows_.size(); ++row) rows_[row] = row;
    tree_.k = options.k;
    tree_.levels = options.levels;
    tree_.weighting = options.weighting;
    tree_.scoring = options.scoring;
    tree_.descriptor_bytes = descriptor_bytes;
    add_row(0, nullptr);
  }

  VocabularyTree operator()() {
    std::vector<Node> level = {{0, 0, rows_.size()}};
    WordId words = 0;
    for (int depth = 0; depth < options_.levels && !level.empty(); ++depth) {
      std::vector<Split> splits(level.size());
      split_level(level, splits);
      std::vector<Node> below;
      for (std::size_t n = 0; n < level.size(); ++n) {
        append_children(level[n], splits[n], depth + 1, below, words);
      }
      level.swap(below);
    }
    return std::move(tree_);
  }

 private:
  std::size_t k() const { return static_cast<std::size_t>(options_.k); }

  void report(std::size_t rows) { done_ += rows; }
  void show() {
    if (!options_.progress) return;
    const std::size_t total = samples_.count * static_cast<std::size_t>(options_.levels);
    const std::size_t done = std::min<std::size_t>(done_, total);
    if (done < shown_ + total / 512) return;
    shown_ = done;
    options_.progress(done, total);
  }

  /// Large nodes one after the other, on all threads; the others a thread each.
  void split_level(const std::vector<Node>& level, std::vector<Split>& splits) {
    const std::size_t large = options_.threads > 1
                                  ? std::max<std::size_t>(4 * kPiece, samples_.count / 16)
                                  : ~std::size_t{0};
    std::vector<std::size_t> small;
    for (std::size_t n = 0; n < level.size(); ++n) {
      if (level[n].size() < large) {
        small.push_back(n);
        continue;
      }
      splits[n] = split(level[n], options_.threads);
      report(level[n].size());
      show();
    }
    constexpr std::size_t kNodesAtOnce = 32;
    detail::for_each_part((small.size() + kNodesAtOnce - 1) / kNodesAtOnce, options_.threads,
                          [&](std::size_t part) {
                            const std::size_t end =
                                std::min((part + 1) * kNodesAtOnce, small.size());
                            for (std::size_t i = part * kNodesAtOnce; i < end; ++i) {
                              splits[small[i]] = split(level[small[i]], 1);
                              report(level[small[i]].size());
                            }
                          },
                          [this] { show(); });
  }

  /// Clusters a node's rows and sorts them by cluster.
  Split split(const Node& node, int threads) {
    std::uint32_t* const rows = rows_.data() + node.begin;
    std::uint8_t* const nearest = nearest_.data() + node.begin;
    Split result;
    seed_centres(rows, node, result.centres, threads);
    std::size_t count = result.centres.size() / samples_.words;
    std::vector<std::uint64_t> before;
    for (int round = 0;; ++round) {
      assign(rows, node.size(), result.centres, nearest, threads);
      if (round == options_.max_rounds || count == 1) break;
      before = result.centres;
      average(rows, node.size(), nearest, result.centres, threads);
      if (result.centres == before) break;
    }
    sort_rows(rows, node.size(), nearest, count, result);
    return result;
  }

  /// k-means++. Stops early when every row is a seed, or equal to one.
  void seed_centres(const std::uint32_t* rows, const Node& node,
                    std::vector<std::uint64_t>& centres, int threads) {
    NodeRandom random(options_.seed, std::uint64_t{node.parent} + 1);
    std::vector<std::uint16_t> distances(node.size(), 0xFFFF);
    std::vector<std::uint64_t> sums((node.size() + kPiece - 1) / kPiece);
    std::size_t chosen = random.below(node.size());
    while (true) {
      const std::uint64_t* seed = samples_.at(rows[chosen]);
      centres.insert(centres.end(), seed, seed + samples_.words);
      if (centres.size() == k() * samples_.words) return;
      for_each_piece(
          node.size(), threads, [&](std::size_t piece, std::size_t first, std::size_t n) {
            sums[piece] = detail::lower_distances(samples_.bits.data(), samples_.words,
                                                  rows + first, n, seed, distances.data() + first);
          });
      std::uint64_t total = 0;
      for (const std::uint64_t sum : sums) total += sum;
      if (total == 0) return;
      std::uint64_t left = random.below(total);
      std::size_t piece = 0;
      while (left >= sums[piece]) left -= sums[piece++];
      chosen = piece * kPiece;
      while (left >= distances[chosen]) left -= distances[chosen++];
    }
  }

  template <typename Work>
  void for_each_piece(std::size_t count, int threads, Work work) {
    const std::size_t pieces = (count + kPiece - 1) / kPiece;
    detail::for_each_part(
        pieces, threads,
        [&](std::size_t piece) {
          work(piece, piece * kPiece, std::min(kPiece, count - piece * kPiece));
        },
        [] {});
  }

  void assign(const std::uint32_t* rows, std::size_t count,
              const std::vector<std::uint64_t>& centres, std::uint8_t* nearest, int threads) {
    for_each_piece(count, threads, [&](std::size_t, std::size_t first, std::size_t n) {
      detail::assign_nearest(samples_.bits.data(), samples_.words, rows + first, n, centres.data(),
                             centres.size() / samples_.words, nearest + first);
    });
  }

  /// Centres become the majority of their rows; one without rows stays.
  void average(const std::uint32_t* rows, std::size_t count, const std::uint8_t* nearest,
               std::vector<std::uint64_t>& centres, int threads) {
    const std::size_t clusters = centres.size() / samples_.words;
    const std::size_t groups =
        std::min<std::size_t>(static_cast<std::size_t>(threads), (count + kPiece - 1) / kPiece);
    std::vector<std::vector<detail::BitCounter>> counters(
        groups, std::vector<detail::BitCounter>(clusters, detail::BitCounter(samples_.words)));
    detail::for_each_part(
        groups, threads,
        [&](std::size_t group) {
          for (std::size_t i = group * count / groups; i < (group + 1) * count / groups; ++i) {
            counters[group][nearest[i]].add(samples_.at(rows[i]));
          }
        },
        [] {});
    for (std::size_t c = 0; c < clusters; ++c) {
      for (std::size_t g = 1; g < groups; ++g) counters[0][c].add(counters[g][c]);
      if (counters[0][c].added() > 0) counters[0][c].majority(centres.data() + c * samples_.words);
    }
  }

  /// Rows of cluster 0 first, then those of 1, ...; clusters without rows go.
  void sort_rows(std::uint32_t* rows, std::size_t count, const std::uint8_t* nearest,
                 std::size_t clusters, Split& result) {
    std::vector<std::size_t> next(clusters + 1, 0);
    for (std::size_t i = 0; i < count; ++i) ++next[nearest[i] + std::size_t{1}];
    for (std::size_t c = 0; c < clusters; ++c) next[c + 1] += next[c];
    std::vector<std::size_t> begins(next);
    std::vector<std::uint32_t> sorted(count);
    for (std::size_t i = 0; i < count; ++i) sorted[next[nearest[i]]++] = rows[i];
    std::copy(sorted.begin(), sorted.end(), rows);
    std::vector<std::uint64_t> kept;
    for (std::size_t c = 0; c < clusters; ++c) {
      if (begins[c] == begins[c + 1]) continue;
      const auto centre = result.centres.begin() + static_cast<std::ptrdiff_t>(c * samples_.words);
      kept.insert(kept.end(), centre, centre + static_cast<std::ptrdiff_t>(samples_.words));
      result.ends.push_back(begins[c + 1]);
    }
    result.centres.swap(kept);
  }

  void append_children(const Node& node, const Split& split, int depth, std::vector<Node>& below,
                       WordId& words) {
    std::size_t begin = node.begin;
    for (std::size_t c = 0; c < split.ends.size(); ++c) {
      const std::uint32_t row = add_row(node.parent, split.centres.data() + c * samples_.words);
      const Node child = {row, begin, node.begin + split.ends[c]};
      begin = child.end;
      if (depth < options_.levels && splits_further(child)) {
        below.push_back(child);
      } else {
        tree_.words[row] = words++;
        report(child.size() * static_cast<std::size_t>(options_.levels - depth));
      }
    }
  }

  bool splits_further(const Node& node) const {
    if (node.size() < static_cast<std::size_t>(options_.min_split)) return false;
    for (std::size_t i = node.begin + 1; i < node.end; ++i) {
      if (!samples_.equal(rows_[node.begin], rows_[i])) return true;
    }
    return false;
  }

  std::uint32_t add_row(std::uint32_t parent, const std::uint64_t* centre) {
    const std::size_t bytes = static_cast<std::size_t>(tree_.descriptor_bytes);
    tree_.parents.push_back(parent);
    tree_.words.push_back(kNoWord);
    tree_.weights.push_back(1.0);
    tree_.descriptors.resize(tree_.descriptors.size() + bytes, 0);
    if (centre != nullptr)
      std::memcpy(tree_.descriptors.data() + tree_.descriptors.size() - bytes, centre, bytes);
    return static_cast<std::uint32_t>(tree_.nodes() - 1);
  }

  const Samples& samples_;
  const TrainingOptions& options_;
  std::vector<std::uint32_t> rows_;    // sorted by node
  std::vector<std::uint8_t> nearest_;  // of each place in rows_
  VocabularyTree tree_;
  std::atomic<std::size_t> done_{0};
  std::size_t shown_ = 0;
};

Samples copy_samples(DescriptorsView descriptors) {
  Samples samples;
  samples.count = static_cast<std::size_t>(descriptors.height);
  samples.words = (static_cast<std::size_t>(descriptors.width) + 7) / 8;
  samples.bits.assign(samples.count * samples.words, 0);
  for (int row = 0; row < descriptors.height; ++row) {
    std::memcpy(samples.bits.data() + static_cast<std::size_t>(row) * samples.words,
                descriptors.row(row), static_cast<std::size_t>(descriptors.width));
  }
  return samples;
}

void check_images(Span<const std::size_t> image_ends, std::size_t rows) {
  constexpr const char* where = "train_vocabulary";
  if (image_ends.empty()) return;
  require(image_ends.size() > 1, where, "image_ends.size()", image_ends.size(),
          "none, or 2 images at least: of one alone every weight is 0");
  std::size_t before = 0;
  for (const std::size_t end : image_ends) {
    require(end >= before, where, "image_ends[i]", end, "at least " + std::to_string(before));
    before = end;
  }
  require(before == rows, where, "image_ends.back()", before, rows);
}

/// ln(N / N_i), in floats.
std::vector<double> inverse_frequencies(const Vocabulary& vocabulary, DescriptorsView descriptors,
                                        Span<const std::size_t> image_ends, int threads) {
  std::vector<WordId> words(static_cast<std::size_t>(descriptors.height));
  const std::size_t parts = (words.size() + kPiece - 1) / kPiece;
  detail::for_each_part(
      parts, threads,
      [&](std::size_t part) {
        const std::size_t begin = part * kPiece;
        const std::size_t count = std::min(kPiece, words.size() - begin);
        const DescriptorsView piece(descriptors.row(static_cast<int>(begin)), descriptors.width,
                                    static_cast<int>(count), descriptors.stride_bytes);
        vocabulary.find_words(piece, Span<WordId>(words).subspan(begin, count));
      },
      [] {});
  std::vector<std::uint32_t> images(vocabulary.words(), 0);
  std::vector<std::size_t> last_image(vocabulary.words(), ~std::size_t{0});
  std::size_t row = 0;
  for (std::size_t image = 0; image < image_ends.size(); ++image) {
    for (; row < image_ends[image]; ++row) {
      const WordId word = words[row];
      if (last_image[word] != image) ++images[word];
      last_image[word] = image;
    }
  }
  std::vector<double> weights(vocabulary.words(), 0.0);
  const double total = static_cast<double>(image_ends.size());
  for (std::size_t word = 0; word < weights.size(); ++word) {
    // A word that no descriptor arrives at any more, because centres moved last, is as rare as one
    // that a single image has.
    const double count = std::max(images[word], 1U);
    weights[word] = static_cast<double>(static_cast<float>(std::log(total / count)));
  }
  return weights;
}

}  // namespace

void TrainingOptions::validate() const {
  constexpr const char* where = "TrainingOptions";
  require(k >= 2 && k <= 255, where, "k", k, "2 .. 255");
  require(levels >= 1 && levels <= 20, where, "levels", levels, "1 .. 20");
  require(static_cast<int>(weighting) <= 3, where, "weighting", static_cast<int>(weighting),
          "0 .. 3");
  require(static_cast<int>(scoring) <= 5, where, "scoring", static_cast<int>(scoring), "0 .. 5");
  require(max_rounds >= 1, where, "max_rounds", max_rounds, "at least 1");
  require(min_split >= 2, where, "min_split", min_split, "at least 2");
  require(threads >= 1, where, "threads", threads, "at least 1");
}

Vocabulary train_vocabulary(DescriptorsView descriptors, Span<const std::size_t> image_ends,
                            const TrainingOptions& options) {
  constexpr const char* where = "train_vocabulary";
  options.validate();
  require(!descriptors.empty(), where, "descriptors", "none", "2 different ones at least");
  require(descriptors.width <= kMaxDescriptorBytes, where, "descriptors.width", descriptors.width,
          "1 .. " + std::to_string(kMaxDescriptorBytes));
  check_images(image_ends, static_cast<std::size_t>(descriptors.height));
  const Samples samples = copy_samples(descriptors);
  bool differ = false;
  for (std::uint32_t row = 1; row < samples.count && !differ; ++row)
    differ = !samples.equal(0, row);
  require(differ, where, "descriptors", "equal ones alone", "2 different ones at least");

  VocabularyTree tree = Trainer(samples, descriptors.width, options)();
  const bool counts_images =
      options.weighting == Weighting::kTfIdf || options.weighting == Weighting::kIdf;
  if (!counts_images || image_ends.empty()) return make_vocabulary(tree);
  const std::vector<double> weights =
      inverse_frequencies(make_vocabulary(tree), descriptors, image_ends, options.threads);
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    if (tree.words[row] != kNoWord) tree.weights[row] = weights[tree.words[row]];
  }
  return make_vocabulary(tree);
}

}  // namespace dynslam::loop
