// A loop detector on a walk that comes back: what it answers, and why it refuses.
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "dynslam/loop/loop_detector.hpp"

namespace loop = dynslam::loop;

namespace {

constexpr std::size_t kWords = 10000;

/// The words of the image at a place: half its own, the rest shared with the places beside it.
loop::BowVector image_at(int place, unsigned noise) {
  loop::BowVector bow;
  std::mt19937 other(noise);
  for (int part = place; part < place + 3; ++part) {
    std::mt19937 words(static_cast<unsigned>(part));
    for (int i = 0; i < 40; ++i) bow.add(words() % kWords, 1.0);
  }
  for (int i = 0; i < 40; ++i) bow.add(other() % kWords, 1.0);
  bow.normalize(loop::Norm::kL1);
  return bow;
}

/// Stands for the geometric verification of a real system: here the truth is known.
loop::Verification verify(int place_of_query, int place_of_candidate) {
  loop::Verification result;
  result.matches = 60;
  const bool same = std::abs(place_of_query - place_of_candidate) <= 1;
  result.inliers = same ? 45 : 6;
  result.verdict = same ? loop::Verdict::kVerified : loop::Verdict::kNoGeometry;
  return result;
}

}  // namespace

int main() {
  // 60 places out, 60 places home by another way, then the first places again.
  std::vector<int> places;
  for (int i = 0; i < 120; ++i) places.push_back(i);
  for (int i = 0; i < 10; ++i) places.push_back(i);

  // [example]
  loop::LoopDetector detector{loop::Database(kWords)};
  const auto check = [&](std::uint64_t query, std::uint64_t candidate) {
    return verify(places[query], places[candidate]);
  };
  for (std::uint64_t id = 0; id < places.size(); ++id) {
    const loop::BowVector bow = image_at(places[id], static_cast<unsigned>(1000 + id));
    const loop::LoopResult result = detector.detect({id, &bow, {}}, check);
    if (result) std::printf("image %d is the place of image %d\n", int(id), int(result.match));
    detector.add(id, bow);
    // [/example]
    if (!result && id >= 118) {
      std::printf("image %d: %s (score %.3f, normalizer %.3f, %d in a row)\n", int(id),
                  std::string(loop::to_string(result.reason)).c_str(), result.best_score,
                  result.normalizer, result.islands.empty() ? 0 : result.islands[0].consistent);
    }
  }
  std::printf("%zu images in %.2f MB\n", detector.database().size(),
              1e-6 * static_cast<double>(detector.database().bytes()));
  return 0;
}
