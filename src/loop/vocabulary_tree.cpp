#include "dynslam/loop/vocabulary_tree.hpp"

#include <algorithm>
#include <cstring>
#include <numeric>
#include <string>

#include "dynslam/core/errors.hpp"

#include "loop/tree_problem.hpp"
#include "loop/vocabulary_block.hpp"

namespace dynslam::loop {
namespace detail {
namespace {

std::string decimal(std::uint64_t value) { return std::to_string(value); }
std::string row_text(std::size_t row) { return "row " + decimal(row) + ": "; }

std::optional<std::string> problem_of_sizes(const VocabularyTree& tree) {
  const auto bad = [](const char* what, auto got, const std::string& expected) {
    return std::string(what) + " is " + std::to_string(got) + ", expected " + expected;
  };
  if (tree.k < 1 || tree.k > kMaxChildren) return bad("k", tree.k, "1 .. " + decimal(kMaxChildren));
  if (tree.levels < 1 || tree.levels > kMaxLevels)
    return bad("levels", tree.levels, "1 .. " + decimal(kMaxLevels));
  if (tree.descriptor_bytes < 1 || tree.descriptor_bytes > kMaxDescriptorBytes)
    return bad("descriptor_bytes", tree.descriptor_bytes, "1 .. " + decimal(kMaxDescriptorBytes));
  if (static_cast<int>(tree.weighting) > 3)
    return bad("weighting", static_cast<int>(tree.weighting), "0 .. 3");
  if (static_cast<int>(tree.scoring) > 5)
    return bad("scoring", static_cast<int>(tree.scoring), "0 .. 5");
  const std::size_t nodes = tree.nodes();
  if (nodes < 2 || nodes > kMaxNodes)
    return bad("number of nodes", nodes, "2 .. " + decimal(kMaxNodes));
  const std::size_t bytes = nodes * static_cast<std::size_t>(tree.descriptor_bytes);
  if (tree.descriptors.size() != bytes)
    return bad("descriptors.size()", tree.descriptors.size(), decimal(bytes));
  const std::size_t stride = descriptor_stride(static_cast<std::size_t>(tree.descriptor_bytes));
  if (nodes * (stride + 20) / 8 >= kLeafBit)
    return bad("number of nodes", nodes, "fewer: links reach 16 GB");
  if (tree.words.size() != nodes) return bad("words.size()", tree.words.size(), decimal(nodes));
  if (tree.weights.size() != nodes)
    return bad("weights.size()", tree.weights.size(), decimal(nodes));
  if (!tree.ids.empty() && tree.ids.size() != nodes)
    return bad("ids.size()", tree.ids.size(), "0 or " + decimal(nodes));
  if (tree.parents[0] != 0) return bad("parent of the root", tree.parents[0], "0");
  for (std::size_t row = 1; row < nodes; ++row) {
    if (tree.parents[row] >= nodes)
      return row_text(row) + "parent " + decimal(tree.parents[row]) + " of " + decimal(nodes) +
             " nodes";
  }
  return std::nullopt;
}

std::optional<std::string> problem_of_ids(const VocabularyTree& tree) {
  if (tree.ids.empty()) return std::nullopt;
  std::vector<bool> seen(tree.nodes(), false);
  if (tree.ids[0] != 0) return "id of the root is " + decimal(tree.ids[0]) + ", expected 0";
  for (std::size_t row = 0; row < tree.nodes(); ++row) {
    if (tree.ids[row] >= tree.nodes())
      return row_text(row) + "id " + decimal(tree.ids[row]) + " of " + decimal(tree.nodes()) +
             " nodes";
    if (seen[tree.ids[row]])
      return row_text(row) + "id " + decimal(tree.ids[row]) + " a second time";
    seen[tree.ids[row]] = true;
  }
  return std::nullopt;
}

/// Numbers of words leave no more room empty than the descriptors take.
std::size_t word_limit(const VocabularyTree& tree) {
  return tree.nodes() * (static_cast<std::size_t>(tree.descriptor_bytes) + 8) / 8;
}

std::optional<std::string> problem_of_words(const VocabularyTree& tree) {
  const std::size_t limit = word_limit(tree);
  std::vector<double> weights;  // of words seen, -1 for the others
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    const WordId word = tree.words[row];
    if (word == kNoWord) continue;
    const double weight = tree.weights[row];
    if (word >= limit)
      return row_text(row) + "word " + decimal(word) + " in a tree of " + decimal(tree.nodes()) +
             " nodes";
    if (!(weight >= 0.0 && weight <= kMaxWordWeight))
      return row_text(row) + "weight " + std::to_string(weight) + ", expected 0 .. 1e12";
    if (word >= weights.size()) weights.resize(word + std::size_t{1}, -1.0);
    if (weights[word] >= 0.0 && weights[word] != weight)
      return row_text(row) + "word " + decimal(word) + " a second time, with another weight";
    weights[word] = weight;
  }
  return std::nullopt;
}

}  // namespace

Children::Children(const VocabularyTree& tree) : begins_(tree.nodes() + 1, 0), rows_(tree.nodes()) {
  for (std::size_t row = 1; row < tree.nodes(); ++row) ++begins_[tree.parents[row] + 1U];
  std::partial_sum(begins_.begin(), begins_.end(), begins_.begin());
  std::vector<std::uint32_t> next(begins_.begin(), begins_.end() - 1);
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    rows_[next[tree.parents[row]]++] = static_cast<std::uint32_t>(row);
  }
}

std::optional<std::string> problem_of_tree(const VocabularyTree& tree) {
  if (auto problem = problem_of_sizes(tree)) return problem;
  if (auto problem = problem_of_ids(tree)) return problem;
  if (auto problem = problem_of_words(tree)) return problem;
  const Children children(tree);
  std::vector<std::uint32_t> level = {0};
  std::vector<std::uint32_t> below;
  std::size_t reached = 1;
  for (int depth = 0; !level.empty(); ++depth) {
    below.clear();
    for (const std::uint32_t row : level) {
      const Span<const std::uint32_t> own = children.of(row);
      if (own.size() > static_cast<std::size_t>(tree.k))
        return row_text(row) + decimal(own.size()) + " children, expected at most " +
               decimal(tree.k);
      const bool is_word = row != 0 && tree.words[row] != kNoWord;
      if (is_word && !own.empty()) return row_text(row) + "is a word and has children";
      if (!is_word && own.empty()) return row_text(row) + "is no word and has no children";
      if (depth > tree.levels)
        return row_text(row) + "lies deeper than the " + decimal(tree.levels) +
               " levels of the tree";
      below.insert(below.end(), own.begin(), own.end());
    }
    reached += below.size();
    level.swap(below);
  }
  if (reached != tree.nodes()) {
    return decimal(tree.nodes() - reached) + " of " + decimal(tree.nodes()) +
           " nodes are not connected with the root";
  }
  return std::nullopt;
}

namespace {

/// In which order the blocks of the parents lie.
class Order {
 public:
  Order(const VocabularyTree& tree, const Children& children) : tree_(tree), children_(children) {
    by_id();
    if (!keeps_ids_) by_level();
  }
  const std::vector<std::uint32_t>& parents() const { return parents_; }
  /// Nodes are called by their numbers.
  bool keeps_ids() const { return keeps_ids_; }

 private:
  NodeId id(std::uint32_t row) const { return tree_.ids.empty() ? row : tree_.ids[row]; }

  /// By the ids of the children, if those come out as 1, 2, 3, ...: no table of ids is needed then.
  void by_id() {
    std::vector<std::uint32_t> row_of_id(tree_.nodes());
    for (std::uint32_t row = 0; row < tree_.nodes(); ++row) row_of_id[id(row)] = row;
    std::vector<bool> placed(tree_.nodes(), false);
    for (std::size_t next = 1; next < tree_.nodes();) {
      const std::uint32_t parent = tree_.parents[row_of_id[next]];
      if (parent != 0 && !placed[parent]) return;  // before its parent
      for (const std::uint32_t child : children_.of(parent)) {
        if (id(child) != next) return;
        placed[child] = true;
        ++next;
      }
      parents_.push_back(parent);
    }
    keeps_ids_ = parents_.front() == 0;
  }

  void by_level() {
    parents_.assign(1, 0);
    for (std::size_t i = 0; i < parents_.size(); ++i) {
      for (const std::uint32_t child : children_.of(parents_[i])) {
        if (!children_.of(child).empty()) parents_.push_back(child);
      }
    }
  }

  const VocabularyTree& tree_;
  const Children& children_;
  std::vector<std::uint32_t> parents_;
  bool keeps_ids_ = false;
};

}  // namespace

std::shared_ptr<const VocabularyBlock> block_of_tree(const VocabularyTree& tree) {
  const Children children(tree);
  const Order order(tree, children);
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  const std::size_t stride = descriptor_stride(bytes);

  std::vector<std::uint32_t> place(tree.nodes(), 0);  // of a parent's block, in units of 8 bytes
  std::uint64_t end = 0;
  for (const std::uint32_t parent : order.parents()) {
    place[parent] = static_cast<std::uint32_t>(end / 8);
    end += block_bytes(children.of(parent).size(), stride);
  }
  WordId words = 0;
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    if (tree.words[row] != kNoWord) words = std::max(words, tree.words[row] + 1);
  }

  auto block = std::make_shared<VocabularyBlock>();
  BlockHeader& header = block->header;
  std::memcpy(header.magic, kBlockMagic, sizeof(kBlockMagic));
  header.byte_order = kBlockByteOrder;
  header.version = kBlockVersion;
  header.tree_bytes = end;
  header.k = static_cast<std::uint32_t>(tree.k);
  header.levels = static_cast<std::uint32_t>(tree.levels);
  header.descriptor_bytes = static_cast<std::uint32_t>(tree.descriptor_bytes);
  header.nodes = static_cast<std::uint32_t>(tree.nodes());
  header.parents = static_cast<std::uint32_t>(order.parents().size());
  header.words = words;
  header.weighting = static_cast<std::uint32_t>(tree.weighting);
  header.scoring = static_cast<std::uint32_t>(tree.scoring);
  header.single_precision = tree.single_precision ? 1 : 0;
  lay_out(header, !order.keeps_ids());

  const std::shared_ptr<std::uint8_t> memory = allocate_block(header.file_bytes);
  auto* weights = reinterpret_cast<double*>(memory.get() + header.weights_offset);
  auto* ids = reinterpret_cast<NodeId*>(memory.get() + header.ids_offset);
  std::uint32_t number = 1;
  for (const std::uint32_t parent : order.parents()) {
    const Span<const std::uint32_t> own = children.of(parent);
    std::uint8_t* at = memory.get() + header.tree_offset + std::size_t{8} * place[parent];
    const std::uint32_t count = static_cast<std::uint32_t>(own.size());
    std::memcpy(at, &count, 4);
    std::memcpy(at + 4, &number, 4);
    for (std::size_t i = 0; i < own.size(); ++i, ++number) {
      const std::uint32_t row = own[i];
      const bool is_word = tree.words[row] != kNoWord;
      const std::uint32_t link = is_word ? kLeafBit | tree.words[row] : place[row];
      std::memcpy(at + 8 + 4 * i, &link, 4);
      std::memcpy(at + descriptors_offset(own.size()) + i * stride,
                  tree.descriptors.data() + row * bytes, bytes);
      if (is_word) weights[tree.words[row]] = tree.weights[row] + 0.0;  // -0 becomes 0
      if (!order.keeps_ids()) ids[number] = tree.ids.empty() ? row : tree.ids[row];
    }
  }
  seal(header, {memory.get() + sizeof(BlockHeader), header.file_bytes - sizeof(BlockHeader)});
  std::memcpy(memory.get(), &header, sizeof(header));
  block->memory = memory;
  return block;
}

}  // namespace detail

Vocabulary make_vocabulary(const VocabularyTree& tree) {
  if (const auto problem = detail::problem_of_tree(tree)) {
    throw InvalidArgument("make_vocabulary: tree: " + *problem);
  }
  return Vocabulary(detail::block_of_tree(tree));
}

VocabularyTree tree_of(const Vocabulary& vocabulary) {
  const detail::VocabularyBlock& block = vocabulary.block();
  const std::size_t nodes = vocabulary.nodes();
  const std::size_t bytes = block.header.descriptor_bytes;
  VocabularyTree tree;
  tree.k = vocabulary.k();
  tree.levels = vocabulary.levels();
  tree.weighting = vocabulary.weighting();
  tree.scoring = vocabulary.scoring();
  tree.descriptor_bytes = vocabulary.descriptor_bytes();
  tree.single_precision = vocabulary.single_precision();
  tree.parents.assign(nodes, 0);
  tree.descriptors.assign(nodes * bytes, 0);
  tree.words.assign(nodes, kNoWord);
  tree.weights.assign(nodes, 0.0);
  if (block.ids() != nullptr) tree.ids.assign(block.ids(), block.ids() + nodes);

  // Rows are numbers; a block learns its parent from the link that leads there, which came before.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> links;  // place in the tree, row
  std::uint32_t row = 1;
  std::size_t at = 0;
  for (std::uint32_t parent = 0; parent < block.header.parents; ++parent) {
    std::uint32_t children;
    std::memcpy(&children, block.tree() + at, 4);
    for (std::uint32_t i = 0; i < children; ++i, ++row) {
      std::uint32_t link;
      std::memcpy(&link, block.tree() + at + 8 + 4 * std::size_t{i}, 4);
      std::memcpy(tree.descriptors.data() + row * bytes,
                  block.tree() + at + detail::descriptors_offset(children) + i * block.stride(),
                  bytes);
      tree.parents[row] = parent;  // a block yet, its row below
      if ((link & detail::kLeafBit) != 0) {
        tree.words[row] = link & ~detail::kLeafBit;
        tree.weights[row] = block.weights()[tree.words[row]];
      } else {
        links.emplace_back(link, row);
      }
    }
    at += detail::block_bytes(children, block.stride());
  }
  std::sort(links.begin(), links.end());
  for (std::size_t r = 1; r < nodes; ++r) {
    const std::uint32_t parent = tree.parents[r];
    tree.parents[r] = parent == 0 ? 0 : links[parent - 1].second;
  }
  return tree;
}

void renumber_words(VocabularyTree& tree) {
  WordId next = 0;
  for (std::size_t row = 1; row < tree.words.size(); ++row) {
    if (tree.words[row] != kNoWord) tree.words[row] = next++;
  }
}

}  // namespace dynslam::loop
