#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/image_view.hpp"
#include "dynslam/core/points.hpp"
#include "dynslam/core/span.hpp"
#include "dynslam/core/tensor_view.hpp"
#include "dynslam/core/version.hpp"

namespace dynslam {
namespace {

struct Feature {
  float x, y;
  int octave;
};

const int* first_of(Span<const int> numbers) { return numbers.data(); }

TEST(Span, BindsAVectorAnArrayAndATemporaryWithoutACopy) {
  std::vector<int> vector{1, 2, 3};
  std::array<int, 2> array{4, 5};
  int raw[] = {6};
  EXPECT_EQ(first_of(vector), vector.data());
  EXPECT_EQ(first_of(array), array.data());
  EXPECT_EQ(first_of(raw), raw);
  EXPECT_EQ(Span<const int>(vector).size(), 3U);
  EXPECT_TRUE(Span<const int>().empty());
}

TEST(Span, OfMutableElementsWritesThrough) {
  std::vector<int> vector{1, 2, 3};
  Span<int> span(vector);
  span[1] = 7;
  EXPECT_EQ(vector[1], 7);
  EXPECT_EQ(span.subspan(1, 2)[0], 7);
}

TEST(Span, DoesNotBindWhatWouldDangleOrDropConst) {
  EXPECT_FALSE((std::is_constructible_v<Span<int>, std::vector<int>>));
  EXPECT_FALSE((std::is_constructible_v<Span<int>, const std::vector<int>&>));
  EXPECT_FALSE((std::is_constructible_v<Span<const double>, const std::vector<int>&>));
  EXPECT_TRUE((std::is_constructible_v<Span<const int>, std::vector<int>&>));
}

TEST(StridedSpan, SeesOneMemberOfEveryStructInPlace) {
  std::vector<Feature> features{{1, 2, 3}, {4, 5, 6}, {7, 8, 9}};
  auto octaves = field(features, &Feature::octave);
  ASSERT_EQ(octaves.size(), 3U);
  EXPECT_EQ(&octaves[2], &features[2].octave);
  int sum = 0;
  for (int octave : octaves) sum += octave;
  EXPECT_EQ(sum, 18);
  octaves[0] = 30;
  EXPECT_EQ(features[0].octave, 30);
}

TEST(StridedSpan, OfAnEmptyContainerIsEmpty) {
  const std::vector<Feature> none;
  EXPECT_TRUE(field(none, &Feature::x).empty());
}

TEST(Points, BindAVectorOfEigenPointsWithoutACopy) {
  std::vector<Eigen::Vector2d> points{{1, 2}, {3, 4}};
  Points2d bound = as_points<double>(points);
  EXPECT_EQ(bound.data(), points[0].data());
  EXPECT_EQ(bound(1, 1), 4.0);
}

TEST(Points, BindAMemberOfStructsWithoutACopy) {
  struct Observation {
    Eigen::Vector3f point;
    float weight;
  };
  std::vector<Observation> observations(4);
  for (int i = 0; i < 4; ++i) observations[static_cast<std::size_t>(i)].point.setConstant(float(i));
  const auto bind = [](Points3f points) { return points.data(); };
  const auto columns = as_points<float>(field(observations, &Observation::point));
  EXPECT_EQ(bind(columns), observations[0].point.data());
  EXPECT_EQ(columns(2, 3), 3.0F);
}

TEST(ImageView, AddressesPixelsByRowStride) {
  std::vector<std::uint8_t> pixels(3 * 10);
  ImageView<std::uint8_t> image(pixels.data(), 4, 3, 10);
  image(3, 2) = 9;
  EXPECT_EQ(pixels[23], 9);
  EXPECT_EQ(image.row(1), pixels.data() + 10);
  EXPECT_TRUE(image.contains(3, 2));
  EXPECT_FALSE(image.contains(4, 2));
  const GrayView read = image;
  EXPECT_EQ(read.data, pixels.data());
  EXPECT_TRUE(read.same_size(image));
  EXPECT_TRUE(GrayView().empty());
}

TEST(TensorView, IsContiguousByChannelThenRow) {
  std::vector<float> values(2 * 3 * 4);
  TensorView<float> tensor(values.data(), 2, 3, 4);
  tensor(1, 2, 3) = 5.0F;
  EXPECT_EQ(values.back(), 5.0F);
  EXPECT_EQ(tensor.plane(1), values.data() + 12);
  EXPECT_EQ(tensor.size(), values.size());
  EXPECT_TRUE(TensorView<const float>(tensor).same_shape(tensor));
}

TEST(Errors, NameFunctionParameterAndBothValues) {
  try {
    require(false, "solve", "max_iterations", 0, "at least 1");
    FAIL() << "nothing thrown";
  } catch (const InvalidArgument& error) {
    EXPECT_STREQ(error.what(), "solve: max_iterations: got 0, expected at least 1");
  }
  EXPECT_NO_THROW(require(true, "solve", "max_iterations", 1, "at least 1"));
}

TEST(Errors, OfFilesBeginWithThePath) {
  try {
    throw_io_error("a/b.png", "truncated after 10 bytes");
    FAIL() << "nothing thrown";
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "a/b.png: truncated after 10 bytes");
  }
}

TEST(Version, TextAgreesWithTheNumbers) {
  EXPECT_EQ(std::string(kVersion), std::to_string(DYNSLAM_VERSION_MAJOR) + "." +
                                       std::to_string(DYNSLAM_VERSION_MINOR) + "." +
                                       std::to_string(DYNSLAM_VERSION_PATCH));
}

}  // namespace
}  // namespace dynslam
