// ORBvoc.txt: "k L scoring weighting", then a line a node: parent, whether it is a word, the bytes
// of its descriptor, its weight. A node's number is its line; words count in the order of lines.
#include <charconv>
#include <cmath>
#include <queue>
#include <string>
#include <string_view>

#include "dynslam/core/errors.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"

namespace dynslam::loop::detail {
namespace {

constexpr int kTextMaxK = 20;
constexpr int kTextMaxLevels = 10;
constexpr std::size_t kMaxLine = 4096;  // 256 bytes of a descriptor in digits take 1024

/// Lines of a source, blank ones left out.
class Lines {
 public:
  explicit Lines(ByteSource& source) : source_(source), buffer_(1U << 16) {}

  /// False at the end.
  bool next(std::string_view& line) {
    while (true) {
      line_.clear();
      ++number_;
      bool any = false;
      while (true) {
        if (at_ == end_) {
          at_ = 0;
          end_ = source_.read(buffer_.data(), buffer_.size());
          if (end_ == 0) break;
        }
        any = true;
        const char c = static_cast<char>(buffer_[at_++]);
        if (c == '\n') break;
        if (line_.size() == kMaxLine)
          fail("longer than " + std::to_string(kMaxLine) + " characters");
        line_.push_back(c);
      }
      if (!any) return false;
      if (line_.find_first_not_of(" \t\r") == std::string::npos) continue;
      line = line_;
      return true;
    }
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw_io_error(source_.path(), "line " + std::to_string(number_) + ": " + what);
  }

 private:
  ByteSource& source_;
  std::vector<std::uint8_t> buffer_;
  std::size_t at_ = 0;
  std::size_t end_ = 0;
  std::string line_;
  std::size_t number_ = 0;
};

/// Numbers of a line.
class Tokens {
 public:
  Tokens(const Lines& lines, std::string_view line) : lines_(lines), line_(line) {}

  bool at_end() {
    while (!line_.empty() &&
           (line_.front() == ' ' || line_.front() == '\t' || line_.front() == '\r'))
      line_.remove_prefix(1);
    return line_.empty();
  }
  std::string_view next(const char* what) {
    if (at_end()) lines_.fail(std::string("ends before ") + what);
    const std::size_t size = std::min(line_.find_first_of(" \t\r"), line_.size());
    const std::string_view token = line_.substr(0, size);
    line_.remove_prefix(size);
    return token;
  }
  template <typename T>
  T number(const char* what, T low, T high) {
    const std::string_view token = next(what);
    T value{};
    const auto [end, error] = std::from_chars(token.data(), token.data() + token.size(), value);
    if (error != std::errc() || end != token.data() + token.size() || !(value >= low) ||
        !(value <= high)) {
      lines_.fail(std::string(what) + " is \"" + std::string(token) + "\", expected " +
                  std::to_string(low) + " .. " + std::to_string(high));
    }
    return value;
  }

 private:
  const Lines& lines_;
  std::string_view line_;
};

}  // namespace

VocabularyTree read_text(ByteSource& source) {
  Lines lines(source);
  std::string_view line;
  if (!lines.next(line)) throw_io_error(source.path(), "is empty");
  VocabularyTree tree;
  Tokens header(lines, line);
  tree.k = header.number("k", 1, kTextMaxK);
  tree.levels = header.number("L", 1, kTextMaxLevels);
  tree.scoring = static_cast<Scoring>(header.number("scoring", 0, 5));
  tree.weighting = static_cast<Weighting>(header.number("weighting", 0, 3));
  if (!header.at_end()) lines.fail("more than four numbers in the header");

  tree.parents.assign(1, 0);
  tree.words.assign(1, kNoWord);
  tree.weights.assign(1, 0.0);
  std::size_t bytes = 0;
  WordId words = 0;
  std::vector<std::string_view> numbers;
  while (lines.next(line)) {
    if (tree.nodes() >= kMaxNodes) lines.fail("more than " + std::to_string(kMaxNodes) + " nodes");
    Tokens tokens(lines, line);
    const auto last = static_cast<std::uint32_t>(tree.nodes() - 1);
    tree.parents.push_back(tokens.number("parent", 0U, last));
    const bool is_word = tokens.number("is leaf", 0, 1) == 1;
    numbers.clear();
    while (!tokens.at_end()) numbers.push_back(tokens.next("a number"));
    if (bytes == 0) {
      if (numbers.size() < 2 || numbers.size() > kMaxDescriptorBytes + 1)
        lines.fail(std::to_string(numbers.size()) +
                   " numbers behind the first two, expected 2 .. " +
                   std::to_string(kMaxDescriptorBytes + 1) + " (a descriptor and a weight)");
      bytes = numbers.size() - 1;
      tree.descriptor_bytes = static_cast<int>(bytes);
      tree.descriptors.assign(bytes, 0);
    }
    if (numbers.size() != bytes + 1)
      lines.fail(std::to_string(numbers.size()) + " numbers behind the first two, expected " +
                 std::to_string(bytes + 1));
    for (std::size_t b = 0; b < bytes; ++b) {
      Tokens token(lines, numbers[b]);
      tree.descriptors.push_back(
          static_cast<std::uint8_t>(token.number("a byte of the descriptor", 0, 255)));
    }
    Tokens weight(lines, numbers.back());
    tree.weights.push_back(weight.number("weight", 0.0, kMaxWordWeight));
    tree.words.push_back(is_word ? words++ : kNoWord);
  }
  return tree;
}

namespace {

/// An order of the rows in which parents come before children, siblings keep their order, and words
/// ascend; empty if there is none.
std::vector<std::uint32_t> text_order(const VocabularyTree& tree,
                                      const std::vector<std::uint32_t>& row_of_word) {
  const Children children(tree);
  const std::size_t nodes = tree.nodes();
  const auto id = [&tree](std::uint32_t row) { return tree.ids.empty() ? row : tree.ids[row]; };
  // What a row waits for: its parent or elder sibling, and the word before its own.
  std::vector<std::uint8_t> waits(nodes, 1);
  for (std::size_t word = 1; word < row_of_word.size(); ++word) waits[row_of_word[word]] = 2;
  std::vector<std::uint32_t> younger(nodes, 0);
  for (std::uint32_t row = 0; row < nodes; ++row) {
    const auto own = children.of(row);
    for (std::size_t i = 1; i < own.size(); ++i) younger[own[i - 1]] = own[i];
  }
  // Of the rows that may come the one of the lowest number, which keeps its number if it can.
  using Entry = std::pair<NodeId, std::uint32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> ready;
  std::vector<std::uint32_t> order = {0};
  const auto release = [&](std::uint32_t row) {
    if (--waits[row] == 0) ready.emplace(id(row), row);
  };
  release(children.of(0)[0]);
  while (!ready.empty()) {
    const std::uint32_t row = ready.top().second;
    ready.pop();
    order.push_back(row);
    if (younger[row] != 0) release(younger[row]);
    const WordId word = tree.words[row];
    if (word == kNoWord) {
      release(children.of(row)[0]);
    } else if (word + std::size_t{1} < row_of_word.size()) {
      release(row_of_word[word + 1]);
    }
  }
  if (order.size() != nodes) order.clear();
  return order;
}

}  // namespace

void write_text(const VocabularyTree& tree, FileSink& sink) {
  if (tree.k > kTextMaxK || tree.levels > kTextMaxLevels) {
    throw InvalidArgument(
        "save_vocabulary: ORBvoc.txt holds trees of k <= 20 and levels <= 10, got " +
        std::to_string(tree.k) + " and " + std::to_string(tree.levels));
  }
  const std::vector<std::uint32_t> order = text_order(tree, rows_of_words(tree, "ORBvoc.txt"));
  if (order.empty()) {
    throw InvalidArgument(
        "save_vocabulary: ORBvoc.txt numbers words in the order of its nodes, which is not "
        "possible "
        "with the numbers of this vocabulary (renumber_words numbers them anew)");
  }
  std::vector<std::uint32_t> line_of_row(tree.nodes());
  for (std::uint32_t line = 0; line < order.size(); ++line) line_of_row[order[line]] = line;
  std::string text = std::to_string(tree.k) + ' ' + std::to_string(tree.levels) + "  " +
                     std::to_string(static_cast<int>(tree.scoring)) + ' ' +
                     std::to_string(static_cast<int>(tree.weighting)) + '\n';
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  for (std::size_t line = 1; line < order.size(); ++line) {
    const std::uint32_t row = order[line];
    const bool is_word = tree.words[row] != kNoWord;
    text += std::to_string(line_of_row[tree.parents[row]]) + (is_word ? " 1 " : " 0 ");
    for (std::size_t b = 0; b < bytes; ++b) {
      text += std::to_string(tree.descriptors[row * bytes + b]) + ' ';
    }
    text += ' ';
    append_number(text, is_word ? tree.weights[row] : 0.0);
    text += '\n';
    if (text.size() > 1U << 16) {
      sink.write(text);
      text.clear();
    }
  }
  sink.write(text);
}

}  // namespace dynslam::loop::detail
