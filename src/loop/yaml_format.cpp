// DBoW2 and DBoW3 through OpenCV's FileStorage:
//   vocabulary: {k, L, scoringType, weightingType,
//                nodes: [{nodeId, parentId, weight, descriptor: "b0 b1 ..."}],
//                words: [{wordId, nodeId}]}
// Descriptors are "b0 b1 ..." (DBoW2), "type cols b0 b1 ..." or "dbw3 type cols b0 b1 ..." (DBoW3).
// Only the part of YAML that FileStorage writes is read.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>

#include "dynslam/core/errors.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"

namespace dynslam::loop::detail {
namespace {

constexpr std::size_t kMaxToken = 4096;  // a descriptor of 256 bytes has 1024 characters

struct Token {
  enum Kind { kEnd, kKey, kValue, kText, kDash, kPunctuation };
  Kind kind = kEnd;
  std::string text;
};

class Lexer {
 public:
  explicit Lexer(ByteSource& source) : source_(source), buffer_(1U << 16) {}

  const Token& next() {
    token_.text.clear();
    skip_blank();
    const int c = peek();
    if (c < 0) return set(Token::kEnd);
    if (c == '"') return quoted();
    if (c == '{' || c == '}' || c == '[' || c == ']' || c == ',') {
      token_.text.push_back(static_cast<char>(take()));
      return set(Token::kPunctuation);
    }
    while (peek() >= 0 && !ends_word(peek())) append(take());
    if (token_.text == "-") return set(Token::kDash);
    if (peek() == ':') {
      take();
      return set(Token::kKey);
    }
    if (token_.text.empty()) fail("unexpected character");
    return set(Token::kValue);
  }

  /// What follows a key: a quoted text, or what stands up to a comma, a bracket or the line's end.
  const Token& next_value() {
    skip_blank();
    if (peek() == '"') return next();
    token_.text.clear();
    while (peek() >= 0 && (peek() == ' ' || peek() == '\t' || !ends_word(peek()))) append(take());
    while (!token_.text.empty() && (token_.text.back() == ' ' || token_.text.back() == '\t'))
      token_.text.pop_back();
    if (token_.text.empty()) fail("a key without a value");
    return set(Token::kValue);
  }

  [[noreturn]] void fail(const std::string& what) const {
    throw_io_error(source_.path(), "line " + std::to_string(line_) + ": " + what);
  }

 private:
  const Token& set(Token::Kind kind) {
    token_.kind = kind;
    return token_;
  }

  /// White space, comments, the %YAML line and "---".
  void skip_blank() {
    while (true) {
      const int c = peek();
      if (c == '\n') {
        take();
        at_line_begin_ = true;
      } else if (c == ' ' || c == '\t' || c == '\r') {
        take();
      } else if (c == '#' || (c == '%' && at_line_begin_)) {
        skip_line();
      } else if (c == '-' && at_line_begin_ && starts_document()) {
        skip_line();
      } else {
        at_line_begin_ = false;
        return;
      }
    }
  }

  /// "---" at the begin of a line, which is within the buffer.
  bool starts_document() {
    return column_ == 0 && end_ - at_ >= 3 && buffer_[at_ + 1] == '-' && buffer_[at_ + 2] == '-';
  }

  void skip_line() {
    while (peek() >= 0 && peek() != '\n') take();
  }

  const Token& quoted() {
    take();
    while (peek() != '"') {
      if (peek() < 0) fail("the file ends within a text");
      int c = take();
      if (c == '\\') c = take();  // digits and letters need no escapes; what follows stands
      append(c);
    }
    take();
    return set(Token::kText);
  }

  static bool ends_word(int c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\n' || c == ':' || c == ',' || c == '{' ||
           c == '}' || c == '[' || c == ']' || c == '"';
  }

  void append(int c) {
    if (token_.text.size() == kMaxToken)
      fail("a text of more than " + std::to_string(kMaxToken) + " characters");
    token_.text.push_back(static_cast<char>(c));
  }

  int peek() {
    if (at_ + 3 >= end_ && !exhausted_) refill();
    return at_ < end_ ? buffer_[at_] : -1;
  }

  void refill() {
    const std::size_t left = end_ - at_;
    std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(at_),
              buffer_.begin() + static_cast<std::ptrdiff_t>(end_), buffer_.begin());
    const std::size_t got = source_.read(buffer_.data() + left, buffer_.size() - left);
    exhausted_ = got < buffer_.size() - left;
    at_ = 0;
    end_ = left + got;
  }

  int take() {
    const int c = peek();
    if (c < 0) return c;
    ++at_;
    ++column_;
    if (c == '\n') {
      ++line_;
      column_ = 0;
    }
    return c;
  }

  ByteSource& source_;
  std::vector<std::uint8_t> buffer_;
  std::size_t at_ = 0;
  std::size_t end_ = 0;
  bool exhausted_ = false;
  bool at_line_begin_ = true;
  std::size_t line_ = 1;
  std::size_t column_ = 0;
  Token token_;
};

class YamlReader {
 public:
  explicit YamlReader(ByteSource& source) : source_(source), lexer_(source) {}

  VocabularyTree operator()() {
    take(Token::kKey, "the key \"vocabulary\"");
    if (text_ != "vocabulary") lexer_.fail("key \"" + text_ + "\", expected \"vocabulary\"");
    advance();
    while (kind_ == Token::kKey) read_member();
    if (kind_ != Token::kEnd) lexer_.fail("\"" + text_ + "\" behind the vocabulary");
    for (const auto& [value, name] : {std::pair{&k_, "k"},
                                      {&levels_, "L"},
                                      {&scoring_, "scoringType"},
                                      {&weighting_, "weightingType"}}) {
      if (!*value) throw_io_error(source_.path(), std::string("there is no key \"") + name + "\"");
    }
    if (!table_) throw_io_error(source_.path(), "there are no nodes");
    VocabularyTree tree = table_->finish();
    if (all_counted_) drop_counts(tree);
    tree.k = *k_;
    tree.levels = *levels_;
    tree.scoring = static_cast<Scoring>(*scoring_);
    tree.weighting = static_cast<Weighting>(*weighting_);
    return tree;
  }

 private:
  void advance() { keep(lexer_.next()); }
  void advance_to_value() { keep(lexer_.next_value()); }
  void keep(const Token& token) {
    kind_ = token.kind;
    text_ = token.text;
  }
  void take(Token::Kind kind, const char* what) {
    advance();
    if (kind_ != kind) lexer_.fail("\"" + text_ + "\", expected " + what);
  }
  void take_punctuation(char c) {
    advance();
    if (kind_ != Token::kPunctuation || text_[0] != c)
      lexer_.fail("\"" + text_ + "\", expected \"" + c + "\"");
  }

  template <typename T>
  T number(const std::string& name, T low, T high) {
    T value{};
    // FileStorage leaves the digits behind the point out, from_chars understands that.
    const char* end_of_text = text_.data() + text_.size();
    const auto [end, error] = std::from_chars(text_.data(), end_of_text, value);
    if (kind_ != Token::kValue || error != std::errc() || end != end_of_text || !(value >= low) ||
        !(value <= high)) {
      lexer_.fail(name + " is \"" + text_ + "\", expected " + std::to_string(low) + " .. " +
                  std::to_string(high));
    }
    return value;
  }

  void read_member() {
    const std::string key = text_;
    const auto small = [&](std::optional<int>& value, int low, int high) {
      if (value) lexer_.fail("\"" + key + "\" a second time");
      advance_to_value();
      value = number(key, low, high);
      advance();
    };
    if (key == "k") return small(k_, 1, kMaxChildren);
    if (key == "L") return small(levels_, 1, kMaxLevels);
    if (key == "scoringType") return small(scoring_, 0, 5);
    if (key == "weightingType") return small(weighting_, 0, 3);
    if (key == "nodes") return read_list([this] { read_node(); });
    if (key == "words") {
      if (!table_) lexer_.fail("words before nodes");
      return read_list([this] { read_word(); });
    }
    lexer_.fail("unknown key \"" + key + "\"");
  }

  /// "- {...}" lines, or "[ {...}, ... ]".
  template <typename ReadItem>
  void read_list(ReadItem read_item) {
    advance();
    if (kind_ == Token::kPunctuation && text_ == "[") {
      advance();
      while (kind_ == Token::kPunctuation && text_ == "{") {
        read_item();
        advance();
        if (kind_ == Token::kPunctuation && text_ == ",") advance();
      }
      if (kind_ != Token::kPunctuation || text_ != "]")
        lexer_.fail("\"" + text_ + "\", expected \"]\"");
      advance();
      return;
    }
    while (kind_ == Token::kDash) {
      take_punctuation('{');
      read_item();
      advance();
    }
  }

  /// The members of a map whose "{" was taken, up to its "}".
  template <typename Member>
  void read_map(Member member) {
    while (true) {
      take(Token::kKey, "a key");
      const std::string key = text_;
      advance_to_value();
      member(key);
      advance();
      if (kind_ == Token::kPunctuation && text_ == "}") return;
      if (kind_ != Token::kPunctuation || text_ != ",")
        lexer_.fail("\"" + text_ + "\", expected \",\" or \"}\"");
    }
  }

  void read_node() {
    std::optional<NodeId> id, parent;
    std::optional<double> weight;
    std::string descriptor;
    read_map([&](const std::string& key) {
      if (key == "nodeId") {
        id = number<NodeId>(key, 1, kMaxNodes);
      } else if (key == "parentId") {
        parent = number<NodeId>(key, 0, kMaxNodes);
      } else if (key == "weight") {
        weight = number<double>(key, 0.0, kMaxWordWeight);
      } else if (key == "descriptor") {
        descriptor = text_;
      } else {
        lexer_.fail("unknown key \"" + key + "\" of a node");
      }
    });
    if (!id || !parent || !weight) lexer_.fail("a node without nodeId, parentId or weight");
    read_descriptor(descriptor);
    if (!table_) table_.emplace(source_, static_cast<int>(bytes_.size()));
    if (bytes_.size() != static_cast<std::size_t>(table_->tree.descriptor_bytes))
      lexer_.fail("a descriptor of " + std::to_string(bytes_.size()) + " bytes among those of " +
                  std::to_string(table_->tree.descriptor_bytes));
    std::copy(bytes_.begin(), bytes_.end(), table_->add(*id, *parent, *weight));
  }

  /// The numbers of a descriptor into bytes_.
  void read_descriptor(std::string_view text) {
    constexpr std::string_view kMark = "dbw3";
    const bool marked = text.substr(0, kMark.size()) == kMark;
    if (marked) text.remove_prefix(kMark.size());
    numbers_.clear();
    while (true) {
      const std::size_t begin = text.find_first_not_of(' ');
      if (begin == std::string_view::npos) break;
      text.remove_prefix(begin);
      int value = 0;
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      if (error != std::errc() || value < 0 || value > 255 ||
          (end != text.data() + text.size() && *end != ' '))
        lexer_.fail("a descriptor that is not made of bytes 0 .. 255");
      text.remove_prefix(static_cast<std::size_t>(end - text.data()));
      numbers_.push_back(value);
      if (numbers_.size() > kMaxDescriptorBytes + 2U)
        lexer_.fail("a descriptor of more than " + std::to_string(kMaxDescriptorBytes) + " bytes");
    }
    // Type 0, the length, and so many bytes: DBoW3's. Without the mark the first two numbers may
    // be bytes as well; which it is, all descriptors of the file decide.
    const bool counted = numbers_.size() > 2 && numbers_[0] == 0 &&
                         static_cast<std::size_t>(numbers_[1]) == numbers_.size() - 2;
    if (marked && !counted) lexer_.fail("a descriptor of DBoW3 that is not binary or not complete");
    if (!counted || marked) all_counted_ = false;
    bytes_.assign(numbers_.begin() + (marked ? 2 : 0), numbers_.end());
    if (bytes_.empty() || bytes_.size() > kMaxDescriptorBytes)
      lexer_.fail("a descriptor of " + std::to_string(bytes_.size()) + " bytes, expected 1 .. " +
                  std::to_string(kMaxDescriptorBytes));
  }

  /// Takes the type and the length away from descriptors that all have them.
  static void drop_counts(VocabularyTree& tree) {
    const std::size_t before = static_cast<std::size_t>(tree.descriptor_bytes);
    const std::size_t after = before - 2;
    for (std::size_t row = 0; row < tree.nodes(); ++row) {
      std::copy_n(tree.descriptors.begin() + static_cast<std::ptrdiff_t>(row * before + 2), after,
                  tree.descriptors.begin() + static_cast<std::ptrdiff_t>(row * after));
    }
    tree.descriptors.resize(tree.nodes() * after);
    tree.descriptor_bytes -= 2;
  }

  void read_word() {
    std::optional<WordId> word;
    std::optional<NodeId> node;
    read_map([&](const std::string& key) {
      if (key == "wordId") {
        word = number<WordId>(key, 0, kMaxNodes);
      } else if (key == "nodeId") {
        node = number<NodeId>(key, 1, kMaxNodes);
      } else {
        lexer_.fail("unknown key \"" + key + "\" of a word");
      }
    });
    if (!word || !node) lexer_.fail("a word without wordId or nodeId");
    table_->add_word(*word, *node);
  }

  ByteSource& source_;
  Lexer lexer_;
  Token::Kind kind_ = Token::kEnd;
  std::string text_;
  std::optional<int> k_, levels_, scoring_, weighting_;
  std::optional<NodeTable> table_;
  bool all_counted_ = true;  // descriptors begin with type 0 and their length
  std::vector<int> numbers_;
  std::vector<std::uint8_t> bytes_;
};

}  // namespace

VocabularyTree read_yaml(ByteSource& source) { return YamlReader(source)(); }

void write_yaml(const VocabularyTree& tree, FileSink& sink) {
  const std::vector<std::uint32_t> row_of_word = rows_of_words(tree, "YAML");
  const auto id = [&tree](std::size_t row) {
    return std::to_string(tree.ids.empty() ? row : tree.ids[row]);
  };
  std::string text = "%YAML:1.0\n---\nvocabulary:\n   k: " + std::to_string(tree.k) +
                     "\n   L: " + std::to_string(tree.levels) +
                     "\n   scoringType: " + std::to_string(static_cast<int>(tree.scoring)) +
                     "\n   weightingType: " + std::to_string(static_cast<int>(tree.weighting)) +
                     "\n   nodes:\n";
  const auto flush = [&](std::size_t limit) {
    if (text.size() <= limit) return;
    sink.write(text);
    text.clear();
  };
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  for (std::size_t row = 1; row < tree.nodes(); ++row) {
    text += "      - { nodeId:" + id(row) + ", parentId:" + id(tree.parents[row]) + ", weight:";
    std::string weight;
    append_number(weight, tree.words[row] != kNoWord ? tree.weights[row] : 0.0);
    // FileStorage tells reals from integers by the point or the exponent.
    if (weight.find_first_of(".e") == std::string::npos) weight += '.';
    text += weight + ",\n          descriptor:\"";
    for (std::size_t b = 0; b < bytes; ++b) {
      text += std::to_string(tree.descriptors[row * bytes + b]) + ' ';
    }
    text += "\" }\n";
    flush(1U << 16);
  }
  text += "   words:\n";
  for (std::size_t word = 0; word < row_of_word.size(); ++word) {
    text +=
        "      - { wordId:" + std::to_string(word) + ", nodeId:" + id(row_of_word[word]) + " }\n";
    flush(1U << 16);
  }
  flush(0);
}

}  // namespace dynslam::loop::detail
