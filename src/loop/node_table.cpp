#include <charconv>

#include "dynslam/core/errors.hpp"

#include "loop/formats.hpp"

namespace dynslam::loop::detail {

NodeTable::NodeTable(ByteSource& source, int descriptor_bytes) : source_(source) {
  tree.descriptor_bytes = descriptor_bytes;
  tree.ids.assign(1, 0);
  tree.parents.assign(1, 0);
  tree.words.assign(1, kNoWord);
  tree.weights.assign(1, 0.0);
  tree.descriptors.assign(static_cast<std::size_t>(descriptor_bytes), 0);
}

void NodeTable::reserve(std::size_t nodes) {
  tree.ids.reserve(nodes);
  tree.parents.reserve(nodes);
  tree.words.reserve(nodes);
  tree.weights.reserve(nodes);
  tree.descriptors.reserve(nodes * static_cast<std::size_t>(tree.descriptor_bytes));
}

std::uint8_t* NodeTable::add(NodeId id, NodeId parent, double weight) {
  if (tree.nodes() >= kMaxNodes) source_.fail("more than " + std::to_string(kMaxNodes) + " nodes");
  if (!(weight >= 0.0 && weight <= kMaxWordWeight)) {
    source_.fail("node " + std::to_string(id) + ": weight " + std::to_string(weight) +
                 ", expected 0 .. 1e12");
  }
  tree.ids.push_back(id);
  tree.parents.push_back(parent);
  tree.words.push_back(kNoWord);
  tree.weights.push_back(weight);
  const std::size_t at = tree.descriptors.size();
  tree.descriptors.resize(at + static_cast<std::size_t>(tree.descriptor_bytes), 0);
  return tree.descriptors.data() + at;
}

void NodeTable::index() {
  const std::size_t nodes = tree.nodes();
  row_of_id_.assign(nodes, kNoWord);
  for (std::uint32_t row = 0; row < nodes; ++row) {
    const NodeId id = tree.ids[row];
    if (id >= nodes) {
      source_.fail("node " + std::to_string(id) + " of " + std::to_string(nodes) +
                   " nodes with the root");
    }
    if (row_of_id_[id] != kNoWord) source_.fail("node " + std::to_string(id) + " a second time");
    row_of_id_[id] = row;
  }
}

void NodeTable::add_word(WordId word, NodeId id) {
  if (row_of_id_.empty()) index();
  if (id >= tree.nodes() || id == 0) {
    source_.fail("word " + std::to_string(word) + ": node " + std::to_string(id) + " of " +
                 std::to_string(tree.nodes()) + " nodes with the root");
  }
  WordId& own = tree.words[row_of_id_[id]];
  if (own != kNoWord) {
    source_.fail("node " + std::to_string(id) + " is word " + std::to_string(own) + " and word " +
                 std::to_string(word));
  }
  own = word;
}

VocabularyTree NodeTable::finish() {
  if (row_of_id_.empty()) index();
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    NodeId& parent = tree.parents[row];
    if (parent >= tree.nodes()) {
      source_.fail("node " + std::to_string(tree.ids[row]) + ": parent " + std::to_string(parent) +
                   " of " + std::to_string(tree.nodes()) + " nodes with the root");
    }
    parent = row_of_id_[parent];
  }
  row_of_id_ = {};
  bool same = true;
  for (std::uint32_t row = 0; row < tree.nodes(); ++row) same = same && tree.ids[row] == row;
  if (same) tree.ids = {};
  return std::move(tree);
}

std::vector<std::uint32_t> rows_of_words(const VocabularyTree& tree, const char* format) {
  std::size_t words = 0;
  for (std::size_t row = 1; row < tree.nodes(); ++row) words += tree.words[row] != kNoWord;
  std::vector<std::uint32_t> rows(words, kNoWord);
  for (std::uint32_t row = 1; row < tree.nodes(); ++row) {
    const WordId word = tree.words[row];
    if (word == kNoWord) continue;
    if (word >= words || rows[word] != kNoWord) {
      throw InvalidArgument(
          std::string("save_vocabulary: ") + format + " wants words numbered 0 .. " +
          std::to_string(words - 1) + ", each once; got word " + std::to_string(word) +
          (word < words ? " a second time" : "") + " (renumber_words numbers them anew)");
    }
    rows[word] = row;
  }
  return rows;
}

void append_number(std::string& text, double value) {
  char digits[32];
  const auto end = std::to_chars(digits, digits + sizeof(digits), value);
  text.append(digits, end.ptr);
}

}  // namespace dynslam::loop::detail
