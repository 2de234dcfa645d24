// Makes the golden files of this folder with DBoW2, DBoW3 or FBoW, which is chosen by a macro; see
// make_golden.sh. No part of the build.
//
//   make_golden train FILE       trains on the golden images and saves
//   make_golden vectors FILE     loads and prints what the program makes of two golden images
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "golden_features.hpp"

#if defined(WITH_DBOW2)
#include <DBoW2.h>
#include <FORB.h>
#include <TemplatedVocabulary.h>
using Vocabulary = DBoW2::TemplatedVocabulary<DBoW2::FORB::TDescriptor, DBoW2::FORB>;
namespace bow = DBoW2;
#elif defined(WITH_DBOW3)
#include <fstream>

#include <DBoW3.h>
using Vocabulary = DBoW3::Vocabulary;
namespace bow = DBoW3;
#else
#include <fbow.h>
#include <vocabulary_creator.h>
#endif

static cv::Mat matrix(std::size_t image) {
  const auto bytes = golden::image(image);
  return cv::Mat(golden::kFeatures, golden::kDescriptorBytes, CV_8U,
                 const_cast<unsigned char*>(bytes.data()))
      .clone();
}

#if defined(WITH_DBOW2) || defined(WITH_DBOW3)
static std::vector<cv::Mat> rows(std::size_t image) {
  std::vector<cv::Mat> result;
  const cv::Mat m = matrix(image);
  for (int r = 0; r < m.rows; ++r) result.push_back(m.row(r).clone());
  return result;
}

static void print(const bow::BowVector& v, const bow::FeatureVector& f) {
  std::printf("bow %zu", v.size());
  for (const auto& [word, weight] : v) std::printf(" %u %a", word, weight);
  std::printf("\ndirect %zu", f.size());
  for (const auto& [node, features] : f) {
    std::printf(" %u %zu", node, features.size());
    for (const unsigned feature : features) std::printf(" %u", feature);
  }
  std::printf("\n");
}

int main(int, char** arguments) {
  const std::string mode = arguments[1];
  const std::string file = arguments[2];
  std::srand(1);
  if (mode == "train") {
#if defined(WITH_DBOW2)
    std::vector<std::vector<cv::Mat>> images;
    for (std::size_t i = 0; i < golden::kTrainingImages; ++i) images.push_back(rows(i));
#else
    std::vector<cv::Mat> images;
    for (std::size_t i = 0; i < golden::kTrainingImages; ++i) images.push_back(matrix(i));
#endif
    Vocabulary vocabulary(5, 3, bow::TF_IDF, bow::L1_NORM);
    vocabulary.create(images);
    vocabulary.save(file);
    return 0;
  }
#if defined(WITH_DBOW3)
  if (mode == "repack") {  // the same vocabulary in DBoW3's three formats
    Vocabulary vocabulary(file);
    vocabulary.save(std::string(arguments[3]) + ".yml", false);
    for (const bool packed : {false, true}) {
      std::ofstream out(std::string(arguments[3]) + (packed ? "_packed.dbow3" : ".dbow3"),
                        std::ios::binary);
      vocabulary.toStream(out, packed);
    }
    return 0;
  }
  Vocabulary vocabulary(file);
#else
  Vocabulary vocabulary;
  vocabulary.load(file);
#endif
#if defined(WITH_DBOW3)
  constexpr int kWeightings = 1;  // the setters of DBoW3 are out of reach: inline in its source
  constexpr int kScorings = 1;
#else
  constexpr int kWeightings = 4;
  constexpr int kScorings = 6;
#endif
  for (int weighting = 0; weighting < kWeightings; ++weighting) {
    for (int scoring = 0; scoring < kScorings; ++scoring) {
#if defined(WITH_DBOW2)
      vocabulary.setWeightingType(static_cast<bow::WeightingType>(weighting));
      vocabulary.setScoringType(static_cast<bow::ScoringType>(scoring));
#endif
      bow::BowVector a, b;
      bow::FeatureVector fa, fb;
      vocabulary.transform(rows(golden::kTrainingImages), a, fa, 1);
      vocabulary.transform(rows(golden::kTrainingImages + 1), b, fb, 2);
      std::printf("rules %d %d\n", weighting, scoring);
      print(a, fa);
      print(b, fb);
      std::printf("score %a %a\n", vocabulary.score(a, b), vocabulary.score(b, a));
    }
  }
}
#else
int main(int, char** arguments) {
  const std::string mode = arguments[1];
  const std::string file = arguments[2];
  std::srand(1);
  if (mode == "train") {
    std::vector<cv::Mat> images;
    for (std::size_t i = 0; i < golden::kTrainingImages; ++i) images.push_back(matrix(i));
    fbow::VocabularyCreator::Params parameters;
    parameters.k = 5;
    parameters.L = 3;
    parameters.nthreads = 1;
    parameters.maxIters = 10;
    fbow::Vocabulary vocabulary;
    fbow::VocabularyCreator().create(vocabulary, images, "orb", parameters);
    vocabulary.saveToFile(file);
    return 0;
  }
  fbow::Vocabulary vocabulary;
  vocabulary.readFromFile(file);
  for (const std::size_t image : {golden::kTrainingImages, golden::kTrainingImages + 1}) {
    const fbow::fBow v = vocabulary.transform(matrix(image));
    std::printf("bow %zu", v.size());
    for (const auto& [word, weight] : v) std::printf(" %u %a", word, static_cast<double>(weight));
    std::printf("\n");
  }
}
#endif
