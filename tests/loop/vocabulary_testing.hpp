// Trees and descriptors for the tests of vocabularies.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/loop/vocabulary.hpp"
#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_tree.hpp"

#include "loop/formats.hpp"
#include "loop/tree_problem.hpp"
#include "loop/vocabulary_block.hpp"
#include "temp_folder.hpp"

namespace dynslam::loop::testing {

/// Random tree: 1 .. k children a node, words at all levels, weights that are floats.
inline VocabularyTree random_tree(int k, int levels, int bytes, unsigned seed) {
  std::mt19937 random(seed);
  VocabularyTree tree;
  tree.k = k;
  tree.levels = levels;
  tree.descriptor_bytes = bytes;
  struct Open {
    std::uint32_t row;
    int depth;
  };
  const auto add = [&](std::uint32_t parent) {
    tree.parents.push_back(parent);
    tree.words.push_back(kNoWord);
    tree.weights.push_back(0.0);
    for (int b = 0; b < bytes; ++b) {
      tree.descriptors.push_back(
          static_cast<std::uint8_t>(parent == 0 && tree.nodes() == 1 ? 0 : random()));
    }
    return static_cast<std::uint32_t>(tree.nodes() - 1);
  };
  std::vector<Open> open = {{add(0), 0}};
  WordId word = 0;
  for (std::size_t i = 0; i < open.size(); ++i) {
    const Open node = open[i];
    const unsigned most = static_cast<unsigned>(k);
    const unsigned children = node.depth == 0 ? most : 1 + random() % most;
    for (unsigned c = 0; c < children; ++c) {
      const std::uint32_t row = add(node.row);
      if (node.depth + 1 < levels && (node.depth == 0 || random() % 4 != 0)) {
        open.push_back({row, node.depth + 1});
      } else {
        tree.words[row] = word++;
        tree.weights[row] = static_cast<double>(static_cast<float>(random() % 1000 + 1) / 97.0F);
      }
    }
  }
  return tree;
}

struct Descriptors {
  std::vector<std::uint8_t> bytes;
  int width = 32;
  DescriptorsView view() const {
    return {bytes.data(), width, static_cast<int>(bytes.size()) / width};
  }
};

/// Descriptors near nodes of the tree, a bit in eight redrawn.
inline Descriptors near_nodes(const VocabularyTree& tree, std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  Descriptors result;
  result.width = tree.descriptor_bytes;
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t row = 1 + random() % (tree.nodes() - 1);
    for (std::size_t b = 0; b < bytes; ++b) {
      const unsigned noise = random() & random() & random();
      result.bytes.push_back(static_cast<std::uint8_t>(tree.descriptors[row * bytes + b] ^ noise));
    }
  }
  return result;
}

struct Arrival {
  WordId word = 0;
  std::uint32_t row = 0;
  std::vector<std::uint32_t> path;  // rows from level 1 down
};

/// The walk as the documentation says it, one bit after the other.
inline Arrival slow_walk(const VocabularyTree& tree, const std::uint8_t* descriptor) {
  const std::size_t bytes = static_cast<std::size_t>(tree.descriptor_bytes);
  Arrival at;
  while (true) {
    std::uint32_t best = 0;
    int least = 1 << 20;
    for (std::uint32_t row = 1; row < tree.nodes(); ++row) {
      if (tree.parents[row] != at.row) continue;
      int distance = 0;
      for (std::size_t b = 0; b < bytes; ++b) {
        for (unsigned bits = descriptor[b] ^ tree.descriptors[row * bytes + b]; bits != 0;
             bits &= bits - 1)
          ++distance;
      }
      if (distance < least) {
        least = distance;
        best = row;
      }
    }
    at.row = best;
    at.path.push_back(best);
    at.word = tree.words[best];
    if (at.word != kNoWord) return at;
  }
}

inline std::vector<std::uint8_t> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

inline void write_file(const std::string& path, const std::vector<std::uint8_t>& bytes) {
  std::ofstream file(path, std::ios::binary);
  file.write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
}

/// load_vocabulary of bytes in memory, without the disk; gzip goes through a file.
inline Vocabulary load_bytes(VocabularyFormat format, const std::vector<std::uint8_t>& bytes,
                             const std::string& name) {
  if (format == VocabularyFormat::kYamlGz) {
    write_file(name, bytes);
    return load_vocabulary(name);
  }
  if (format == VocabularyFormat::kDynvoc) {
    const auto memory = detail::allocate_block(bytes.size());
    std::copy(bytes.begin(), bytes.end(), memory.get());
    if (const auto problem = detail::problem_of({memory.get(), bytes.size()}))
      throw_io_error(name, *problem);
    auto block = std::make_shared<detail::VocabularyBlock>();
    std::memcpy(&block->header, memory.get(), sizeof(block->header));
    block->memory = memory;
    return Vocabulary(std::move(block));
  }
  detail::MemorySource source(name, bytes);
  const VocabularyTree tree = format == VocabularyFormat::kText   ? detail::read_text(source)
                              : format == VocabularyFormat::kYaml ? detail::read_yaml(source)
                              : format == VocabularyFormat::kFbow ? detail::read_fbow(source)
                                                                  : detail::read_dbow3(source);
  if (const auto problem = detail::problem_of_tree(tree)) throw_io_error(name, *problem);
  return Vocabulary(detail::block_of_tree(tree));
}

/// A path of the running test's own for a temporary file.
inline std::string scratch(const std::string& ending) {
  const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
  std::string name = std::string(test->test_suite_name()) + "_" + test->name() + ending;
  std::replace(name.begin(), name.end(), '/', '_');
  return dynslam::testing::temp_path(name);
}

/// Message of the error of type E that the function throws; fails the test if there is none.
template <typename E, typename Function>
std::string error_of(Function function) {
  try {
    function();
  } catch (const E& error) {
    return error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "another error: " << error.what();
    return {};
  }
  ADD_FAILURE() << "no error";
  return {};
}

}  // namespace dynslam::loop::testing
