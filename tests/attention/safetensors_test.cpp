// Files of weights, sound and not.
#include "dynslam/attention/safetensors.hpp"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::attention {
namespace {

std::vector<std::uint8_t> file_of(const std::string& header, const std::vector<std::uint8_t>& data,
                                  std::uint64_t claimed = ~std::uint64_t{0}) {
  std::vector<std::uint8_t> bytes;
  const std::uint64_t size = claimed == ~std::uint64_t{0} ? header.size() : claimed;
  for (int i = 0; i < 8; ++i) bytes.push_back(static_cast<std::uint8_t>(size >> (8 * i)));
  bytes.insert(bytes.end(), header.begin(), header.end());
  bytes.insert(bytes.end(), data.begin(), data.end());
  return bytes;
}

std::vector<std::uint8_t> floats(const std::vector<float>& values) {
  std::vector<std::uint8_t> bytes(values.size() * 4);
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

std::string refusal(const std::vector<std::uint8_t>& bytes) {
  try {
    SafeTensors::parse(bytes, "weights.st");
  } catch (const IoError& error) {
    return error.what();
  }
  ADD_FAILURE() << "nothing was thrown";
  return {};
}

TEST(SafeTensors, ReadsNamesShapesValuesAndMetadata) {
  const SafeTensors file = SafeTensors::parse(
      file_of(R"({"__metadata__":{"from":"here"},)"
              R"("b":{"dtype":"F32","shape":[],"data_offsets":[8,12]},)"
              R"("a":{"dtype":"F32","shape":[2,1],"data_offsets":[0,8]},)"
              R"("none":{"dtype":"F32","shape":[0,3],"data_offsets":[12,12]}}  )",
              floats({1.5F, -2.0F, 7.0F})),
      "weights.st");
  EXPECT_EQ(file.tensors().size(), 3U);
  EXPECT_EQ(file.at("a").shape, (std::vector<std::int64_t>{2, 1}));
  EXPECT_EQ(file.at("a").values[1], -2.0F);
  EXPECT_EQ(file.at("b").values[0], 7.0F);
  EXPECT_TRUE(file.at("none").values.empty());
  EXPECT_EQ(file.metadata().at("from"), "here");
  EXPECT_FALSE(file.contains("c"));
  EXPECT_THROW(file.at("c"), IoError);
}

TEST(SafeTensors, WidensHalfAndBrainFloats) {
  const SafeTensors file =
      SafeTensors::parse(file_of(R"({"h":{"dtype":"F16","shape":[4],"data_offsets":[0,8]},)"
                                 R"("b":{"dtype":"BF16","shape":[1],"data_offsets":[8,10]}})",
                                 {0x00, 0x3C, 0x00, 0xC0, 0x01, 0x00, 0x00, 0x7C, 0x80, 0x3F}),
                         "weights.st");
  const auto h = file.at("h").values;
  EXPECT_EQ(h[0], 1.0F);
  EXPECT_EQ(h[1], -2.0F);
  EXPECT_EQ(h[2], std::ldexp(1.0F, -24));
  EXPECT_TRUE(std::isinf(h[3]));
  EXPECT_EQ(file.at("b").values[0], 1.0F);
}

TEST(SafeTensors, SurvivesEveryTruncation) {
  const auto whole =
      file_of(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})", floats({1.0F, 2.0F}));
  EXPECT_NO_THROW(SafeTensors::parse(whole, "weights.st"));
  for (std::size_t size = 0; size < whole.size(); ++size) {
    EXPECT_THROW(SafeTensors::parse({whole.data(), size}, "weights.st"), IoError) << size;
  }
}

TEST(SafeTensors, RefusesEveryFieldThatLies) {
  const auto data = floats({1.0F, 2.0F});
  const auto expect = [&](const std::string& header, const std::string& part) {
    const std::string message = refusal(file_of(header, data));
    EXPECT_NE(message.find(part), std::string::npos) << message;
    EXPECT_EQ(message.rfind("weights.st: ", 0), 0U);
  };
  const auto a = [](const std::string& dtype, const std::string& shape, const std::string& at) {
    return "\"a\":{\"dtype\":" + dtype + ",\"shape\":" + shape + ",\"data_offsets\":" + at + "}";
  };
  expect("{", "not a JSON object");
  expect("[1]", "not a JSON object");
  expect(std::string(100000, '['), "not a JSON object");
  expect("{" + a("\"F64\"", "[1]", "[0,8]") + "}", "dtype \"F64\"");
  expect("{" + a("3", "[2]", "[0,8]") + "}", "no dtype");
  expect("{" + a("\"F32\"", "2", "[0,8]") + "}", "no shape");
  expect("{" + a("\"F32\"", "[-2]", "[0,8]") + "}", "dimension");
  expect("{" + a("\"F32\"", "[1.5]", "[0,8]") + "}", "dimension");
  expect("{" + a("\"F32\"", "[2147483647,2147483647,2147483647]", "[0,8]") + "}",
         "larger than the file");
  expect("{" + a("\"F32\"", "[4294967296,4294967296]", "[0,0]") + "}", "dimension");
  expect("{" + a("\"F32\"", "[3]", "[0,8]") + "}", "its shape asks for 12");
  expect("{" + a("\"F32\"", "[2]", "[0,8,9]") + "}", "data_offsets");
  expect("{" + a("\"F32\"", "[2]", "[8,0]") + "}", "data_offsets 8..0");
  expect("{" + a("\"F32\"", "[4]", "[0,16]") + "}", "the file has 8 bytes");
  expect("{" + a("\"F32\"", "[1]", "[4,8]") + "}", "gap of 4 bytes");
  expect("{" + a("\"F32\"", "[1]", "[0,4]") + "}", "belong to no tensor");
  expect("{" + a("\"F32\"", "[2]", "[0,8]") +
             R"(,"b":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}})",
         "overlaps");
  expect("{" + a("\"F32\"", "[2]", "[0,8]") + "," + a("\"F32\"", "[2]", "[0,8]") + "}", "twice");
  expect(R"({"a":7})", "expected an object");
  expect("{\"__metadata__\":{\"k\":1}," + a("\"F32\"", "[2]", "[0,8]") + "}", "__metadata__");
  EXPECT_NE(refusal(file_of("{}", {}, 1U << 30U)).find("cut short"), std::string::npos);
}

TEST(SafeTensors, OfAFileThatIsNotThereSaysSo) {
  EXPECT_THROW(SafeTensors::read("no/such/file.safetensors"), IoError);
  EXPECT_THROW(SafeTensors::read("."), IoError);
}

TEST(LoadedLayers, NameTheTensorThatIsMissingOrMisshapen) {
  const SafeTensors file = SafeTensors::parse(
      file_of(R"({"c.conv.weight":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})",
              floats({1.0F, 2.0F})),
      "weights.st");
  const auto message = [&](const auto& load) -> std::string {
    try {
      load();
    } catch (const IoError& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  EXPECT_NE(message([&] { load_convolution(file, "c."); }).find("expected 4 dimensions"),
            std::string::npos);
  EXPECT_NE(message([&] { load_dfc(file, "x."); }).find("\"x.pointwise.conv.weight\""),
            std::string::npos);
  EXPECT_NE(message([&] { load_cbam(file, ""); }).find("channel.fc0.weight"), std::string::npos);
  EXPECT_NE(message([&] { load_ghost_c3(file, "y."); }).find("y.cv1"), std::string::npos);
}

}  // namespace
}  // namespace dynslam::attention
