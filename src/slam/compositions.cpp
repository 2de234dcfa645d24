#include "dynslam/slam/compositions.hpp"

#include <algorithm>

#include "dynslam/core/errors.hpp"

namespace dynslam::slam {
namespace {

// How a part is told and taken out.
struct PartSwitch {
  Part part;
  const char* name;
  bool (*is_on)(const Composition&);
  void (*switch_off)(Composition&);
};

constexpr PartSwitch kSwitches[] = {
    {Part::kMask, "mask",                           //
     [](const Composition& c) { return c.masks; },  //
     [](Composition& c) { c.masks = false; }},
    {Part::kGeometry, "geometry",                              //
     [](const Composition& c) { return c.options.geometry; },  //
     [](Composition& c) { c.options.geometry = false; }},
    {Part::kWeights, "weights",
     [](const Composition& c) { return c.options.weights != factors::WeightMode::kFixed; },
     [](Composition& c) { c.options.weights = factors::WeightMode::kFixed; }},
    {Part::kRejection, "rejection",                                  //
     [](const Composition& c) { return c.options.reject_matches; },  //
     [](Composition& c) { c.options.reject_matches = false; }},
    {Part::kLoops, "loops",                                         //
     [](const Composition& c) { return c.options.loops.enabled; },  //
     [](Composition& c) { c.options.loops.enabled = false; }},
};

const PartSwitch& switch_of(Part part) {
  return *std::find_if(std::begin(kSwitches), std::end(kSwitches),
                       [&](const PartSwitch& entry) { return entry.part == part; });
}

std::string joined(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

}  // namespace

const char* to_string(Part part) { return switch_of(part).name; }

const std::vector<Part>& all_parts() {
  static const std::vector<Part> parts = [] {
    std::vector<Part> list;
    for (const PartSwitch& entry : kSwitches) list.push_back(entry.part);
    return list;
  }();
  return parts;
}

const std::vector<std::string>& part_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    for (const PartSwitch& entry : kSwitches) list.emplace_back(entry.name);
    return list;
  }();
  return names;
}

Part part_from_name(std::string_view name) {
  for (const PartSwitch& entry : kSwitches) {
    if (name == entry.name) return entry.part;
  }
  throw_invalid_argument("part_from_name", "name", name, "one of " + joined(part_names()));
}

bool Composition::has(Part part) const { return switch_of(part).is_on(*this); }

std::vector<Part> Composition::parts() const {
  std::vector<Part> present;
  for (const Part part : all_parts()) {
    if (has(part)) present.push_back(part);
  }
  return present;
}

Composition Composition::without(Part part) const {
  Composition rest = *this;
  switch_of(part).switch_off(rest);
  return rest;
}

Composition baseline() { return {"baseline", "nothing handles movers", false, {}}; }

Composition p_yolo() {
  return {"p-yolo", "features on masks are dropped before tracking", true, {}};
}

Composition p_static() {
  Composition system{"p-static", "masks, geometric constraint and static weights", true, {}};
  system.options.geometry = true;
  system.options.weights = factors::WeightMode::kEliminated;
  return system;
}

Composition p_mixed() {
  Composition system{"p-mixed", "masks of mixed attention, improbable matches rejected", true, {}};
  system.options.reject_matches = true;
  system.options.mapping.keyframe_similarity = 0.6;
  return system;
}

const std::vector<std::string>& composition_names() {
  static const std::vector<std::string> names = {"baseline", "p-yolo", "p-static", "p-mixed"};
  return names;
}

Composition composition(std::string_view name) {
  for (Composition (*make)() : {baseline, p_yolo, p_static, p_mixed}) {
    Composition candidate = make();
    if (candidate.name == name) return candidate;
  }
  throw_invalid_argument("composition", "name", name, "one of " + joined(composition_names()));
}

}  // namespace dynslam::slam
