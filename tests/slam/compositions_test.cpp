#include "dynslam/slam/compositions.hpp"

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::slam {
namespace {

TEST(Compositions, AreFoundByTheirOwnNamesAndHoldValidOptions) {
  ASSERT_EQ(composition_names().size(), 4U);
  for (const std::string& name : composition_names()) {
    const Composition system = composition(name);
    EXPECT_EQ(system.name, name);
    EXPECT_FALSE(system.summary.empty());
    EXPECT_NO_THROW(system.options.validate());
  }
}

TEST(Compositions, HaveThePartsOfTheirPapers) {
  EXPECT_FALSE(baseline().has(Part::kMask));
  EXPECT_FALSE(baseline().has(Part::kGeometry));
  EXPECT_TRUE(p_yolo().has(Part::kMask));
  EXPECT_FALSE(p_yolo().has(Part::kGeometry));
  for (const Part part : {Part::kMask, Part::kGeometry, Part::kWeights}) {
    EXPECT_TRUE(p_static().has(part)) << to_string(part);
  }
  EXPECT_TRUE(p_mixed().has(Part::kMask));
  EXPECT_TRUE(p_mixed().has(Part::kRejection));
  EXPECT_TRUE(p_mixed().has(Part::kLoops));
}

TEST(Compositions, LoseExactlyThePartThatIsTakenOut) {
  for (const std::string& name : composition_names()) {
    const Composition whole = composition(name);
    for (const Part removed : whole.parts()) {
      const Composition rest = whole.without(removed);
      EXPECT_EQ(rest.name, name);
      for (const Part part : all_parts()) {
        EXPECT_EQ(rest.has(part), part != removed && whole.has(part))
            << name << " without " << to_string(removed) << ": " << to_string(part);
      }
    }
  }
}

TEST(Compositions, StayAsTheyAreWithoutAPartThatTheyLack) {
  EXPECT_EQ(baseline().without(Part::kGeometry).parts(), baseline().parts());
}

TEST(Compositions, HaveNoPartLeftWhenAllAreTakenOut) {
  const auto bare = [](Composition system) {
    for (const Part part : all_parts()) system = system.without(part);
    return system;
  };
  for (const std::string& name : composition_names()) {
    EXPECT_TRUE(bare(composition(name)).parts().empty()) << name;
  }
}

TEST(Compositions, RefuseUnknownNamesAndListTheirOwn) {
  try {
    composition("p-nonsense");
    FAIL() << "a composition of nonsense";
  } catch (const InvalidArgument& error) {
    EXPECT_NE(std::string(error.what()).find("p-nonsense"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("p-static"), std::string::npos);
  }
}

TEST(Parts, AreFoundByTheirOwnNames) {
  ASSERT_EQ(part_names().size(), all_parts().size());
  for (std::size_t i = 0; i < all_parts().size(); ++i) {
    EXPECT_EQ(part_names()[i], to_string(all_parts()[i]));
    EXPECT_EQ(part_from_name(part_names()[i]), all_parts()[i]);
  }
  EXPECT_THROW(part_from_name("wheels"), InvalidArgument);
}

}  // namespace
}  // namespace dynslam::slam
