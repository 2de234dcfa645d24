// Several rules one after another.
#pragma once

#include <cstddef>
#include <cstdint>
#include <tuple>
#include <utility>

#include "dynslam/core/span.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching {

/// Rules one after another: each sees only what those before it kept. A match is kept if all keep
/// it; its weight is the product of the weights of the rules that saw it.
///
/// `chain(RotationConsistency(), DefaultRule())`. A chain is a rule; an empty one keeps everything.
template <typename... Rules>
class Chain {
 public:
  explicit Chain(Rules... rules) : rules_(std::move(rules)...) {}

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      keep[i] = 1;
      weight[i] = 1.0F;
    }
    std::apply([&](const auto&... rule) { (run(rule, pairs, keep, weight, workspace), ...); },
               rules_);
  }

 private:
  template <typename Rule>
  static void run(const Rule& rule, const PairsView& pairs, Span<std::uint8_t> keep,
                  Span<float> weight, Workspace& workspace) {
    const Workspace::Frame frame(workspace);
    const auto source = workspace.take<std::uint32_t>(pairs.size());
    std::size_t count = 0;
    for (std::size_t i = 0; i < pairs.size(); ++i) {
      if (keep[i] != 0) source[count++] = static_cast<std::uint32_t>(i);
    }
    const auto select = [&](Span<const float> all) -> Span<const float> {
      if (all.empty()) return {};
      const auto some = workspace.take<float>(count);
      for (std::size_t k = 0; k < count; ++k) some[k] = all[source[k]];
      return some;
    };
    const PairsView seen{select(pairs.x1),  select(pairs.y1),       select(pairs.x2),
                         select(pairs.y2),  select(pairs.distance), select(pairs.rotation),
                         select(pairs.zoom)};
    const auto kept = workspace.take_filled<std::uint8_t>(count, 0);
    const auto scores = workspace.take_filled<float>(count, 0.0F);
    rule(seen, kept, scores, workspace);
    for (std::size_t k = 0; k < count; ++k) {
      keep[source[k]] = kept[k];
      weight[source[k]] *= scores[k];
    }
  }

  std::tuple<Rules...> rules_;
};

/// Chain of the given rules.
template <typename... Rules>
Chain<Rules...> chain(Rules... rules) {
  return Chain<Rules...>(std::move(rules)...);
}

}  // namespace dynslam::matching
