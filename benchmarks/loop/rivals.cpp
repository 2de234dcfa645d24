// The same vocabulary in dynslam, FBoW and DBoW2, by turns; see rivals.sh. No part of the build.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include <DBoW2.h>
#include <FORB.h>
#include <TemplatedVocabulary.h>
#include <fbow.h>
#include <malloc.h>
#include <opencv2/core.hpp>

#include "dynslam/loop/vocabulary_io.hpp"

#include "grown_vocabulary.hpp"

using Clock = std::chrono::steady_clock;
using namespace dynslam::loop;

static double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// DBoW2's vocabulary, filled in place of being read: its own reader takes YAML only.
class Dbow2 : public DBoW2::TemplatedVocabulary<DBoW2::FORB::TDescriptor, DBoW2::FORB> {
 public:
  explicit Dbow2(const VocabularyTree& tree) {
    m_k = tree.k;
    m_L = tree.levels;
    m_nodes.resize(tree.nodes());
    for (unsigned row = 0; row < tree.nodes(); ++row) {
      Node& node = m_nodes[row];
      node.id = row;
      node.descriptor = cv::Mat(1, 32, CV_8U);
      std::memcpy(node.descriptor.data, tree.descriptors.data() + std::size_t{32} * row, 32);
      if (row > 0) {
        node.parent = tree.parents[row];
        m_nodes[tree.parents[row]].children.push_back(row);
      }
      if (tree.words[row] == kNoWord) continue;
      node.word_id = tree.words[row];
      node.weight = tree.weights[row];
      m_words.push_back(&node);
    }
  }
};

struct Times {
  std::vector<double> ms;
  void add(double value) { ms.push_back(value); }
  double at(double share) {
    std::sort(ms.begin(), ms.end());
    return ms[static_cast<std::size_t>(share * static_cast<double>(ms.size() - 1))];
  }
  void print(const char* name) {
    std::printf("  %-28s median %8.3f ms, best %8.3f, 90 %% %8.3f\n", name, at(0.5), at(0.0),
                at(0.9));
  }
};

static void evict() {
  static std::vector<std::uint64_t> other(std::size_t{64} << 17);
  for (std::size_t i = 0; i < other.size(); i += 8) other[i]++;
}

static double resident_mb() {
  long pages = 0;
  long resident = 0;
  std::FILE* file = std::fopen("/proc/self/statm", "r");
  if (std::fscanf(file, "%ld %ld", &pages, &resident) != 2) resident = 0;
  std::fclose(file);
  return static_cast<double>(resident) * 4096e-6;
}

int main(int argc, char** argv) {
  const std::string folder = argc > 1 ? argv[1] : ".";
  const std::string ours_path = folder + "/grown.dynvoc";
  const std::string fbow_path = folder + "/grown.fbow";
  const VocabularyTree tree = benchmark_data::grown_tree(863000);
  save_vocabulary(make_vocabulary(tree), ours_path);
  save_vocabulary(make_vocabulary(tree), fbow_path);
  std::vector<std::vector<std::uint8_t>> bytes;
  std::vector<cv::Mat> matrices;
  std::vector<std::vector<cv::Mat>> rows;
  for (unsigned i = 0; i < 64; ++i) {
    bytes.push_back(benchmark_data::image_of(tree, 1000, 100 + i));
    matrices.emplace_back(1000, 32, CV_8U, bytes.back().data());
    rows.emplace_back();
    for (int r = 0; r < 1000; ++r) rows.back().push_back(matrices.back().row(r));
  }
  const auto view = [&](std::size_t i) {
    return dynslam::DescriptorsView(bytes[i].data(), 32, 1000);
  };

  std::printf("load, with a first image\n");
  Times ours_load, fbow_load;
  for (int round = 0; round < 15; ++round) {
    {
      const auto start = Clock::now();
      const Vocabulary v = open_vocabulary(ours_path);
      if (v.transform({view(0)}).empty()) return 1;
      ours_load.add(ms_since(start));
    }
    const auto start = Clock::now();
    fbow::Vocabulary v;
    v.readFromFile(fbow_path);
    if (v.transform(matrices[0]).empty()) return 1;
    fbow_load.add(ms_since(start));
  }
  ours_load.print("dynslam, mapped");
  fbow_load.print("FBoW");

  malloc_trim(0);
  double before = resident_mb();
  const Vocabulary ours = open_vocabulary(ours_path);
  std::printf("resident: dynslam %.1f MB", resident_mb() - before);
  before = resident_mb();
  fbow::Vocabulary fbow_vocabulary;
  fbow_vocabulary.readFromFile(fbow_path);
  std::printf(", FBoW %.1f MB", resident_mb() - before);
  before = resident_mb();
  const Dbow2 dbow2(tree);
  std::printf(", DBoW2 %.1f MB\n", resident_mb() - before);

  // The same words, or the times say nothing.
  TransformWorkspace workspace;
  BowVector bow;
  FeatureVector direct;
  ours.transform({view(0)}, bow, &direct, 4, workspace);
  DBoW2::BowVector dbow2_bow;
  DBoW2::FeatureVector dbow2_direct;
  dbow2.transform(rows[0], dbow2_bow, dbow2_direct, 4);
  fbow::fBow fbow_bow = fbow_vocabulary.transform(matrices[0]);
  bool same = bow.size() == dbow2_bow.size() && bow.size() == fbow_bow.size();
  std::size_t w = 0;
  for (const auto& [word, weight] : dbow2_bow) {
    same = same && bow.word(w) == word && bow.weight(w) == weight && fbow_bow.count(word) == 1;
    ++w;
  }
  std::printf("words and weights agree: %s\n", same ? "yes" : "NO");

  for (const bool cold : {true, false}) {
    std::printf("1000 descriptors, %s\n",
                cold ? "own caches emptied before each" : "fresh images, caches left alone");
    Times t[6];
    for (std::size_t round = 0; round < 128; ++round) {
      const std::size_t i = round % 64;
      const auto time = [&](Times& times, auto work) {
        if (cold) evict();
        const auto start = Clock::now();
        work();
        times.add(ms_since(start));
      };
      time(t[0], [&] { ours.transform({view(i)}, bow, nullptr, 4, workspace); });
      time(t[1], [&] { fbow_bow = fbow_vocabulary.transform(matrices[i]); });
      time(t[2], [&] { dbow2.transform(rows[i], dbow2_bow); });
      time(t[3], [&] { ours.transform({view(i)}, bow, &direct, 4, workspace); });
      fbow::fBow2 fbow_direct;
      time(t[4], [&] { fbow_vocabulary.transform(matrices[i], 2, fbow_bow, fbow_direct); });
      time(t[5], [&] { dbow2.transform(rows[i], dbow2_bow, dbow2_direct, 4); });
    }
    const char* names[] = {"dynslam",
                           "FBoW",
                           "DBoW2",
                           "dynslam with direct index",
                           "FBoW with direct index",
                           "DBoW2 with direct index"};
    for (int n = 0; n < 6; ++n) t[n].print(names[n]);
  }
}
