// A vocabulary from start to end: train it, save it, map it, describe images, leave a mover out.
//
// Descriptors are made up: each place has patterns of its own, seen again with some bits changed.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <random>
#include <vector>

#include "dynslam/loop/vocabulary_io.hpp"
#include "dynslam/loop/vocabulary_training.hpp"

namespace {

namespace loop = dynslam::loop;

constexpr int kBytes = 32;
constexpr std::size_t kFeatures = 300;

/// `count` descriptors of a place (or of a mover, which is no different), seen for the n-th time.
std::vector<std::uint8_t> look_at(unsigned place, unsigned nth, std::size_t count = kFeatures) {
  std::mt19937 pattern(place);
  std::mt19937 noise(nth * 7919 + place + 1);
  std::vector<std::uint8_t> bytes(count * kBytes);
  for (auto& byte : bytes)
    byte = static_cast<std::uint8_t>(pattern() ^ (noise() & noise() & noise() & noise()));
  return bytes;
}

dynslam::DescriptorsView view(const std::vector<std::uint8_t>& bytes) {
  return {bytes.data(), kBytes, static_cast<int>(bytes.size() / kBytes)};
}

void append(std::vector<std::uint8_t>& to, const std::vector<std::uint8_t>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

}  // namespace

int main() {
  std::vector<std::uint8_t> descriptors;
  std::vector<std::size_t> image_ends;
  for (unsigned place = 0; place < 60; ++place) {
    for (unsigned nth = 0; nth < 3; ++nth) {
      append(descriptors, look_at(place, nth));
      image_ends.push_back(descriptors.size() / kBytes);
    }
  }

  // [vocabulary]
  loop::TrainingOptions options;
  options.k = 10;
  options.levels = 4;
  options.threads = 2;
  loop::save_vocabulary(loop::train_vocabulary(view(descriptors), image_ends, options),
                        "example.dynvoc");
  const loop::Vocabulary vocabulary = loop::open_vocabulary("example.dynvoc");  // mapped
  const loop::BowVector here = vocabulary.transform({view(look_at(7, 100))});
  const loop::BowVector again = vocabulary.transform({view(look_at(7, 101))});
  std::printf("the same place scores %.2f\n", vocabulary.score(here, again));
  // [vocabulary]

  std::printf("another place scores  %.2f\n",
              vocabulary.score(here, vocabulary.transform({view(look_at(8, 100))})));
  std::printf("%zu words of %d bytes below %zu nodes, %.1f MB\n", vocabulary.words(),
              vocabulary.descriptor_bytes(), vocabulary.nodes(),
              static_cast<double>(vocabulary.bytes()) * 1e-6);

  // Somebody stands in both views: other places look alike until the mask takes the person away.
  const std::vector<std::uint8_t> person = look_at(1000, 0);
  std::vector<std::uint8_t> a = look_at(20, 50);
  std::vector<std::uint8_t> b = look_at(21, 50);
  append(a, person);
  append(b, person);
  std::vector<std::uint8_t> keep(2 * kFeatures, 1);
  for (std::size_t i = kFeatures; i < keep.size(); ++i) keep[i] = 0;
  std::printf("two places, one person: %.2f, masked %.2f\n",
              vocabulary.score(vocabulary.transform({view(a)}), vocabulary.transform({view(b)})),
              vocabulary.score(vocabulary.transform({view(a), keep}),
                               vocabulary.transform({view(b), keep})));

  // The file of another program, and how long each takes to be there.
  loop::save_vocabulary(vocabulary, "example.txt");  // ORBvoc.txt
  for (const char* path : {"example.txt", "example.dynvoc"}) {
    const auto start = std::chrono::steady_clock::now();
    const loop::Vocabulary loaded = loop::load_vocabulary(path);
    const std::chrono::duration<double, std::milli> ms = std::chrono::steady_clock::now() - start;
    std::printf("%-15s %8.3f ms, the same vector: %s\n", path, ms.count(),
                loaded.transform({view(a)}) == vocabulary.transform({view(a)}) ? "yes" : "no");
    std::remove(path);
  }
}
