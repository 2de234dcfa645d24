#include "dynslam/core/protobuf.hpp"

#include <string>
#include <string_view>
#include <vector>

#include <gtest/gtest.h>

namespace dynslam::protobuf {
namespace {

// {1: 300, 2: "kitchen", 2: "office", 3: 0}
std::string message() {
  std::string bytes;
  put_number(bytes, 1, 300);
  put_bytes(bytes, 2, "kitchen");
  put_bytes(bytes, 2, "office");
  put_number(bytes, 3, 0);
  return bytes;
}

TEST(Protobuf, WritesTheBytesOfTheEncodingGuide) {
  std::string bytes;
  put_number(bytes, 1, 150);
  EXPECT_EQ(bytes, std::string("\x08\x96\x01"));
  bytes.clear();
  put_bytes(bytes, 2, "testing");
  EXPECT_EQ(bytes, std::string("\x12\x07testing"));
}

TEST(Protobuf, ReadsWhatItWroteFieldByField) {
  const std::string bytes = message();
  FieldReader reader(bytes);
  Field field;
  std::string again;
  std::vector<std::string> seen;
  while (reader.next(field)) {
    seen.push_back(std::to_string(field.number) + ":" +
                   (field.is_bytes() ? std::string(field.bytes) : std::to_string(field.value)));
    again += field.encoded;
  }
  EXPECT_FALSE(reader.broken());
  EXPECT_EQ(seen, (std::vector<std::string>{"1:300", "2:kitchen", "2:office", "3:0"}));
  EXPECT_EQ(again, bytes);
}

TEST(Protobuf, FindsTheFirstBytesOfANumber) {
  const std::string bytes = message();
  EXPECT_EQ(bytes_of(bytes, 2), "kitchen");
  EXPECT_TRUE(bytes_of(bytes, 1).empty()) << "a number holds no bytes";
  EXPECT_TRUE(bytes_of(bytes, 4).empty());
}

TEST(Protobuf, ReadsNumbersOfFixedSize) {
  const std::string four("\x0D\x01\x02\x00\x00", 5), eight("\x09\x00\x00\x00\x00\x00\x00\xF0?", 9);
  Field field;
  ASSERT_TRUE(FieldReader(four).next(field));
  EXPECT_EQ(field.value, 0x201U);
  ASSERT_TRUE(FieldReader(eight).next(field));
  EXPECT_EQ(field.bytes.size(), 8U);
}

TEST(Protobuf, IsBrokenWhereverAFieldIsCutShort) {
  std::string bytes;
  put_bytes(bytes, 200, "kitchen");
  for (std::size_t size = 1; size < bytes.size(); ++size) {
    FieldReader reader(std::string_view(bytes).substr(0, size));
    Field field;
    EXPECT_FALSE(reader.next(field)) << size;
    EXPECT_TRUE(reader.broken()) << size;
  }
}

TEST(Protobuf, IsBrokenByKeysAndNumbersThatCannotBe) {
  const std::string endless(11, '\xFF');
  for (const std::string& bytes :
       {std::string("\x00\x00", 2), std::string("\x0B"), endless, std::string("\x08") + endless}) {
    FieldReader reader(bytes);
    Field field;
    EXPECT_FALSE(reader.next(field));
    EXPECT_TRUE(reader.broken());
  }
}

TEST(Protobuf, AnEmptyMessageHasNoFieldsAndIsSound) {
  FieldReader reader("");
  Field field;
  EXPECT_FALSE(reader.next(field));
  EXPECT_FALSE(reader.broken());
}

}  // namespace
}  // namespace dynslam::protobuf
