// FBoW's files, little endian: u64 magic, the parameters (120 bytes), blocks of equal size. A block
// is the children of a node: u16 children, u16 all are words, u32 parent, padding; descriptors;
// for each child a u32 and its f32 weight. The u32 is 0x80000000 | word, or the child's own block.
//
// Words are not always numbered without gaps, levels, weighting and scoring are not said. In our
// own files they stand behind the end of the descriptor's name, which has 50 characters; and if
// weights are no floats, they follow the blocks as f64, one for each word number. FBoW looks at
// neither.
#include <algorithm>
#include <cstring>
#include <string>

#include "dynslam/core/errors.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"

namespace dynslam::loop::detail {
namespace {

constexpr std::size_t kNameBytes = 50;
constexpr std::uint32_t kAlignment = 8;  // FBoW's own for binary descriptors
constexpr std::uint32_t kWordBit = 0x80000000U;
constexpr std::uint64_t kBlockHead = 8;
constexpr std::uint64_t kMaxStride = 4096;
constexpr std::uint64_t kMaxBlock = std::uint64_t{1} << 28;

/// The parameters as they lie in the file.
struct Parameters {
  char name[kNameBytes];
  char padding[2];
  std::uint32_t alignment;
  std::uint32_t blocks;
  std::uint32_t padding2;
  std::uint64_t stride;
  std::uint64_t block_bytes;
  std::uint64_t descriptors_offset;
  std::uint64_t children_offset;
  std::uint64_t total_bytes;
  std::int32_t type;
  std::int32_t descriptor_bytes;
  std::uint32_t k;
  std::uint32_t padding3;
};
static_assert(sizeof(Parameters) == 120 && offsetof(Parameters, k) == 112);

/// What the format has no room for, at the end of the name.
struct NameTail {
  char mark[8];
  std::uint32_t words;  // weights behind the blocks, or 0
  std::uint8_t levels;
  std::uint8_t weighting;
  std::uint8_t scoring;
  std::uint8_t single_precision;
};
static_assert(sizeof(NameTail) == 16);
constexpr char kTailMark[8] = {'d', 'y', 'n', 's', 'l', 'a', 'm', '1'};
constexpr std::size_t kTailOffset = kNameBytes - sizeof(NameTail);

void check_parameters(ByteSource& source, const Parameters& p) {
  const auto check = [&source](const char* what, std::uint64_t got, std::uint64_t low,
                               std::uint64_t high) {
    if (got >= low && got <= high) return;
    source.fail(std::string(what) + " is " + std::to_string(got) + ", expected " +
                std::to_string(low) + " .. " + std::to_string(high));
  };
  check("type of the descriptors (0 is binary)", static_cast<std::uint32_t>(p.type), 0, 0);
  check("size of a descriptor", static_cast<std::uint32_t>(p.descriptor_bytes), 1,
        kMaxDescriptorBytes);
  check("k", p.k, 1, kMaxChildren);
  check("number of blocks", p.blocks, 1, kMaxNodes);
  const auto bytes = static_cast<std::uint64_t>(p.descriptor_bytes);
  check("size of a descriptor with padding", p.stride, bytes, kMaxStride);
  check("offset of the descriptors", p.descriptors_offset, kBlockHead, kMaxStride);
  const std::uint64_t descriptors_end = p.descriptors_offset + p.k * p.stride;
  check("offset of the children", p.children_offset, descriptors_end, kMaxBlock);
  check("size of a block", p.block_bytes, p.children_offset + 8 * std::uint64_t{p.k}, kMaxBlock);
  check("size of all blocks", p.total_bytes, p.blocks * p.block_bytes, p.blocks * p.block_bytes);
}

struct Child {
  std::uint32_t link;
  float weight;
};

/// Blocks become rows as they come; parents follow when all links are known.
class FbowReader {
 public:
  explicit FbowReader(ByteSource& source) : source_(source) {}

  VocabularyTree operator()() {
    if (source_.number<std::uint64_t>("the magic number") != kFbowMagic)
      source_.fail("another magic number than that of FBoW");
    p_ = source_.number<Parameters>("the parameters");
    check_parameters(source_, p_);
    if (p_.total_bytes > source_.left())
      source_.fail(std::to_string(p_.total_bytes) + " bytes of blocks, the file has " +
                   std::to_string(source_.left()));
    reserve();
    tree_.descriptor_bytes = p_.descriptor_bytes;
    tree_.k = static_cast<int>(p_.k);
    add_row(kNoWord, 0.0, 0);
    tree_.descriptors.assign(static_cast<std::size_t>(p_.descriptor_bytes), 0);
    std::vector<std::uint8_t> block(p_.block_bytes);
    for (std::uint32_t b = 0; b < p_.blocks; ++b) {
      source_.read_exactly(block.data(), block.size(), "a block");
      add_block(b, block.data());
    }
    connect();
    read_tail();
    std::uint8_t more = 0;
    if (source_.read(&more, 1) != 0) source_.fail("more bytes behind the content");
    return std::move(tree_);
  }

 private:
  /// No more than the blocks take, which are there.
  void reserve() {
    const std::size_t rows = std::size_t{p_.blocks} * p_.k + 1;
    tree_.parents.reserve(rows);
    tree_.words.reserve(rows);
    tree_.weights.reserve(rows);
    tree_.descriptors.reserve(rows * static_cast<std::size_t>(p_.descriptor_bytes));
  }

  void add_row(WordId word, double weight, std::uint32_t block) {
    tree_.parents.push_back(block);
    tree_.words.push_back(word);
    tree_.weights.push_back(weight);
  }

  void add_block(std::uint32_t b, const std::uint8_t* block) {
    std::uint16_t children;
    std::memcpy(&children, block, sizeof(children));
    const std::string where = "block " + std::to_string(b) + ": ";
    if (children < 1 || children > p_.k)
      source_.fail(where + std::to_string(children) + " children, expected 1 .. " +
                   std::to_string(p_.k));
    if (tree_.nodes() + children > kMaxNodes)
      source_.fail("more than " + std::to_string(kMaxNodes) + " nodes");
    for (std::size_t i = 0; i < children; ++i) {
      Child child;
      std::memcpy(&child, block + p_.children_offset + 8 * i, sizeof(child));
      const std::uint8_t* descriptor = block + p_.descriptors_offset + i * p_.stride;
      tree_.descriptors.insert(tree_.descriptors.end(), descriptor,
                               descriptor + p_.descriptor_bytes);
      if ((child.link & kWordBit) != 0) {
        if (!(child.weight >= 0.0F && static_cast<double>(child.weight) <= kMaxWordWeight))
          source_.fail(where + "weight " + std::to_string(child.weight) + ", expected 0 .. 1e12");
        add_row(child.link & ~kWordBit, static_cast<double>(child.weight), b);
      } else {
        if (child.link == 0 || child.link >= p_.blocks)
          source_.fail(where + "child " + std::to_string(i) + " has block " +
                       std::to_string(child.link) + ", expected 1 .. " +
                       std::to_string(p_.blocks - 1));
        links_.emplace_back(child.link, static_cast<std::uint32_t>(tree_.nodes()));
        add_row(kNoWord, 0.0, b);
      }
    }
  }

  /// Parents are blocks yet; each block but the first belongs to the row that links to it.
  void connect() {
    std::sort(links_.begin(), links_.end());
    for (std::size_t i = 0; i + 1 < links_.size(); ++i) {
      if (links_[i].first == links_[i + 1].first)
        source_.fail("two links to block " + std::to_string(links_[i].first));
    }
    if (links_.size() + 1 != p_.blocks)
      source_.fail(std::to_string(links_.size()) + " links to " + std::to_string(p_.blocks - 1) +
                   " blocks");
    // One link to each of 1 .. blocks - 1.
    for (std::size_t row = 1; row < tree_.nodes(); ++row) {
      std::uint32_t& parent = tree_.parents[row];
      parent = parent == 0 ? 0 : links_[parent - 1].second;
    }
    links_ = {};
  }

  /// Levels, weighting and scoring, from the name or by FBoW's rules.
  void read_tail() {
    NameTail tail;
    std::memcpy(&tail, p_.name + kTailOffset, sizeof(tail));
    if (std::memcmp(tail.mark, kTailMark, sizeof(kTailMark)) == 0) {
      if (tail.levels < 1 || tail.weighting > 3 || tail.scoring > 5 || tail.single_precision > 1)
        source_.fail("levels, weighting or scoring behind the descriptor's name are not possible");
      tree_.levels = tail.levels;
      tree_.weighting = static_cast<Weighting>(tail.weighting);
      tree_.scoring = static_cast<Scoring>(tail.scoring);
      tree_.single_precision = tail.single_precision != 0;
      read_weights(tail.words);
      return;
    }
    tree_.weighting = Weighting::kTfIdf;
    tree_.scoring = Scoring::kL2;
    tree_.single_precision = true;
    tree_.levels = depth();
  }

  /// Weights that are no floats.
  void read_weights(std::uint32_t words) {
    if (words == 0) return;
    if (words * std::uint64_t{8} > source_.left() || words > 8 * tree_.nodes())
      source_.fail(std::to_string(words) + " weights behind the blocks, the file ends before");
    std::vector<double> weights(words);
    source_.read_exactly(weights.data(), words * sizeof(double), "the weights behind the blocks");
    for (std::size_t row = 1; row < tree_.nodes(); ++row) {
      if (tree_.words[row] == kNoWord) continue;
      if (tree_.words[row] >= words)
        source_.fail("word " + std::to_string(tree_.words[row]) + " of " + std::to_string(words));
      tree_.weights[row] = weights[tree_.words[row]];
    }
  }

  /// Most steps from the root to a row; kMaxLevels where there are cycles, which are found later.
  int depth() const {
    const Children children(tree_);
    std::vector<std::uint32_t> level = {0};
    std::vector<std::uint32_t> below;
    int depth = 0;
    while (depth < kMaxLevels) {
      below.clear();
      for (const std::uint32_t row : level) {
        const auto own = children.of(row);
        below.insert(below.end(), own.begin(), own.end());
      }
      if (below.empty()) break;
      level.swap(below);
      ++depth;
    }
    return std::max(depth, 1);
  }

  ByteSource& source_;
  Parameters p_{};
  VocabularyTree tree_;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> links_;  // block, row
};

/// f64 weights by word if some of them are no floats, nothing otherwise.
std::vector<double> exact_weights(const VocabularyTree& tree) {
  std::vector<double> weights;
  bool exact = true;
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    const WordId word = tree.words[row];
    if (word == kNoWord) continue;
    const double weight = tree.weights[row];
    exact = exact && static_cast<double>(static_cast<float>(weight)) == weight;
    if (word >= weights.size()) weights.resize(word + std::size_t{1}, 0.0);
    weights[word] = weight;
  }
  if (exact) weights.clear();
  return weights;
}

Parameters parameters_of(const VocabularyTree& tree, std::uint32_t blocks, std::size_t weights) {
  Parameters p{};
  const char name[] = "binary";
  std::memcpy(p.name, name, sizeof(name));
  NameTail tail{};
  std::memcpy(tail.mark, kTailMark, sizeof(kTailMark));
  tail.words = static_cast<std::uint32_t>(weights);
  tail.levels = static_cast<std::uint8_t>(tree.levels);
  tail.weighting = static_cast<std::uint8_t>(tree.weighting);
  tail.scoring = static_cast<std::uint8_t>(tree.scoring);
  tail.single_precision = tree.single_precision ? 1 : 0;
  std::memcpy(p.name + kTailOffset, &tail, sizeof(tail));
  p.alignment = kAlignment;
  p.blocks = blocks;
  p.k = static_cast<std::uint32_t>(tree.k);
  p.type = 0;
  p.descriptor_bytes = tree.descriptor_bytes;
  p.stride = padded(static_cast<std::size_t>(tree.descriptor_bytes), kAlignment);
  p.descriptors_offset = kBlockHead;
  p.children_offset = p.descriptors_offset + p.k * p.stride;
  p.block_bytes = padded(p.children_offset + 8 * std::uint64_t{p.k}, kAlignment);
  p.total_bytes = p.block_bytes * p.blocks;
  return p;
}

}  // namespace

VocabularyTree read_fbow(ByteSource& source) { return FbowReader(source)(); }

void write_fbow(const VocabularyTree& tree, FileSink& sink) {
  // Blocks in the order of the parents' first children: a reader that numbers the nodes block after
  // block gives them the numbers that they have in a tree of ours.
  const Children children(tree);
  std::vector<std::uint32_t> parents;
  for (std::uint32_t row = 0; row < tree.nodes(); ++row) {
    if (!children.of(row).empty()) parents.push_back(row);
  }
  std::sort(parents.begin(), parents.end(), [&](std::uint32_t a, std::uint32_t b) {
    return children.of(a)[0] < children.of(b)[0];
  });
  if (parents.front() != 0) {  // the root's children have to be block 0
    std::rotate(parents.begin(), std::find(parents.begin(), parents.end(), 0U),
                std::find(parents.begin(), parents.end(), 0U) + 1);
  }
  std::vector<std::uint32_t> block_of_row(tree.nodes(), 0);
  for (std::uint32_t b = 0; b < parents.size(); ++b) block_of_row[parents[b]] = b;

  const std::vector<double> weights = exact_weights(tree);
  const Parameters p =
      parameters_of(tree, static_cast<std::uint32_t>(parents.size()), weights.size());
  sink.number(kFbowMagic);
  sink.number(p);
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  std::vector<std::uint8_t> block(p.block_bytes);
  for (const std::uint32_t parent : parents) {
    std::fill(block.begin(), block.end(), std::uint8_t{0});
    const Span<const std::uint32_t> own = children.of(parent);
    const auto count = static_cast<std::uint16_t>(own.size());
    std::uint16_t all_words = 1;
    for (std::size_t i = 0; i < own.size(); ++i) {
      const std::uint32_t row = own[i];
      const WordId word = tree.words[row];
      Child child{};
      child.link = word != kNoWord ? kWordBit | word : block_of_row[row];
      child.weight = word != kNoWord ? static_cast<float>(tree.weights[row]) : 0.0F;
      if (word == kNoWord) all_words = 0;
      std::memcpy(block.data() + p.descriptors_offset + i * p.stride,
                  tree.descriptors.data() + row * bytes, bytes);
      std::memcpy(block.data() + p.children_offset + 8 * i, &child, sizeof(child));
    }
    std::memcpy(block.data(), &count, sizeof(count));
    std::memcpy(block.data() + 2, &all_words, sizeof(all_words));
    std::memcpy(block.data() + 4, &parent, sizeof(parent));
    sink.write(block.data(), block.size());
  }
  if (!weights.empty()) sink.write(weights.data(), weights.size() * sizeof(double));
}

}  // namespace dynslam::loop::detail
