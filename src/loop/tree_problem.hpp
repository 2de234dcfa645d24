// Checking a VocabularyTree and making the block of it, for makers and readers.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/vocabulary_block.hpp"

namespace dynslam::loop::detail {

/// The children of every row, in the order of the rows. Parents are rows.
class Children {
 public:
  explicit Children(const VocabularyTree& tree);
  Span<const std::uint32_t> of(std::uint32_t row) const {
    return {rows_.data() + begins_[row], begins_[row + 1] - begins_[row]};
  }

 private:
  std::vector<std::uint32_t> begins_;
  std::vector<std::uint32_t> rows_;
};

/// What make_vocabulary has against the tree, if anything.
std::optional<std::string> problem_of_tree(const VocabularyTree& tree);

/// The block of a tree without a problem.
std::shared_ptr<const VocabularyBlock> block_of_tree(const VocabularyTree& tree);

}  // namespace dynslam::loop::detail
