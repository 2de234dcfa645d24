// The rules by name, for programs that let their user choose.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/matching/motion_consensus.hpp"
#include "dynslam/matching/pairs.hpp"
#include "dynslam/matching/rules.hpp"
#include "dynslam/matching/workspace.hpp"

namespace dynslam::matching {

/// What `make_rule` understands. "default" is `DefaultRule`.
inline constexpr std::array<std::string_view, 6> kRuleNames = {
    "default", "ModalBin", "FractionOfMode", "ContiguousMode", "RotationConsistency", "NullRule"};

/// One of the rules, chosen at run time; itself a rule. One branch a call, no allocation.
class NamedRule {
 public:
  using Variant = std::variant<DefaultRule, ModalBin, FractionOfMode, ContiguousMode,
                               RotationConsistency, NullRule>;

  NamedRule() = default;
  template <typename Rule>
  NamedRule(std::string_view name, Rule rule) : name_(name), rule_(std::move(rule)) {}

  std::string_view name() const { return name_; }

  void operator()(const PairsView& pairs, Span<std::uint8_t> keep, Span<float> weight,
                  Workspace& workspace) const {
    std::visit([&](const auto& rule) { rule(pairs, keep, weight, workspace); }, rule_);
  }

 private:
  std::string_view name_ = kRuleNames[0];
  Variant rule_;
};

/// The rule of that name with its default options. Throws InvalidArgument that lists the names.
inline NamedRule make_rule(std::string_view name) {
  if (name == kRuleNames[0] || name == "MotionConsensus") return {kRuleNames[0], DefaultRule()};
  if (name == kRuleNames[1]) return {kRuleNames[1], ModalBin()};
  if (name == kRuleNames[2]) return {kRuleNames[2], FractionOfMode()};
  if (name == kRuleNames[3]) return {kRuleNames[3], ContiguousMode()};
  if (name == kRuleNames[4]) return {kRuleNames[4], RotationConsistency()};
  if (name == kRuleNames[5]) return {kRuleNames[5], NullRule()};
  std::string names;
  for (const std::string_view known : kRuleNames) {
    if (!names.empty()) names += ", ";
    names += known;
  }
  throw_invalid_argument("matching::make_rule", "name", name, "one of " + names);
}

}  // namespace dynslam::matching
