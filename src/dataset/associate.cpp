#include <algorithm>
#include <cmath>
#include <queue>
#include <string_view>

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

namespace dynslam::dataset {
namespace {

constexpr std::size_t kNone = static_cast<std::size_t>(-1);

// A time of either list in one list of both, linked so that a pair can be taken out.
struct Stop {
  double time;
  bool of_a;
  std::size_t index;
  std::size_t before = kNone;
  std::size_t after = kNone;
};

struct Candidate {
  double difference;
  std::size_t left, right;  // neighbours in the list, one of a and one of b

  // std::priority_queue has the greatest on top: the closest pair, then the earliest.
  bool operator<(const Candidate& other) const {
    if (difference != other.difference) return difference > other.difference;
    return left > other.left;
  }
};

void add_stops(Span<const double> times, bool of_a, std::vector<Stop>* stops) {
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (std::isfinite(times[i])) stops->push_back({times[i], of_a, i});
  }
}

// The closest pair of what is left is always a pair of neighbours: a time between the two would be
// closer to one of them. So the heap only ever holds neighbours, and each removal adds one pair.
class ClosestFirst {
 public:
  ClosestFirst(std::vector<Stop> stops, double max_difference)
      : stops_(std::move(stops)), max_difference_(max_difference) {
    for (std::size_t i = 0; i < stops_.size(); ++i) {
      stops_[i].before = i == 0 ? kNone : i - 1;
      stops_[i].after = i + 1 < stops_.size() ? i + 1 : kNone;
    }
    for (std::size_t i = 0; i + 1 < stops_.size(); ++i) consider(i, i + 1);
  }

  std::vector<std::pair<std::size_t, std::size_t>> run() {
    std::vector<std::pair<std::size_t, std::size_t>> pairs;  // stop of a, stop of b
    std::vector<bool> taken(stops_.size(), false);
    while (!heap_.empty()) {
      const Candidate best = heap_.top();
      heap_.pop();
      if (taken[best.left] || taken[best.right]) continue;
      taken[best.left] = taken[best.right] = true;
      pairs.push_back(stops_[best.left].of_a ? std::make_pair(best.left, best.right)
                                             : std::make_pair(best.right, best.left));
      join(stops_[best.left].before, stops_[best.right].after);
    }
    std::sort(pairs.begin(), pairs.end());
    for (auto& [a, b] : pairs) {
      a = stops_[a].index;
      b = stops_[b].index;
    }
    return pairs;
  }

 private:
  void join(std::size_t left, std::size_t right) {
    if (left != kNone) stops_[left].after = right;
    if (right != kNone) stops_[right].before = left;
    if (left != kNone && right != kNone) consider(left, right);
  }

  void consider(std::size_t left, std::size_t right) {
    if (stops_[left].of_a == stops_[right].of_a) return;
    const double difference = stops_[right].time - stops_[left].time;
    if (difference <= max_difference_) heap_.push({difference, left, right});
  }

  std::vector<Stop> stops_;
  double max_difference_;
  std::priority_queue<Candidate> heap_;
};

bool is_digit(char c) { return c >= '0' && c <= '9'; }

std::string_view take_digits(std::string_view* s) {
  std::size_t n = 0;
  while (n < s->size() && is_digit((*s)[n])) ++n;
  std::string_view digits = s->substr(0, n);
  s->remove_prefix(n);
  digits.remove_prefix(std::min(digits.find_first_not_of('0'), digits.size()));
  return digits;
}

}  // namespace

std::vector<std::pair<std::size_t, std::size_t>> associate(Span<const double> a,
                                                           Span<const double> b,
                                                           double max_difference) {
  require(max_difference >= 0.0, "associate", "max_difference", max_difference,
          "a number of seconds that is not negative");
  std::vector<Stop> stops;
  stops.reserve(a.size() + b.size());
  add_stops(a, true, &stops);
  add_stops(b, false, &stops);
  std::stable_sort(stops.begin(), stops.end(),
                   [](const Stop& x, const Stop& y) { return x.time < y.time; });
  return ClosestFirst(std::move(stops), max_difference).run();
}

bool natural_less(std::string_view a, std::string_view b) {
  const std::string_view whole_a = a, whole_b = b;
  while (!a.empty() && !b.empty()) {
    if (is_digit(a[0]) && is_digit(b[0])) {
      const std::string_view x = take_digits(&a), y = take_digits(&b);
      if (x.size() != y.size()) return x.size() < y.size();
      if (x != y) return x < y;
    } else {
      if (a[0] != b[0]) return static_cast<unsigned char>(a[0]) < static_cast<unsigned char>(b[0]);
      a.remove_prefix(1);
      b.remove_prefix(1);
    }
  }
  if (a.empty() != b.empty()) return a.empty();
  return whole_a < whole_b;  // "01" and "1": equal numbers, but an order all the same
}

}  // namespace dynslam::dataset
