// The file of a database: round trips, and every field of it broken once.
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/loop/database.hpp"

#include "loop_testing.hpp"
#include "temp_folder.hpp"

namespace dynslam::loop {
namespace {

using Bytes = std::vector<std::uint8_t>;

// Offsets in the file, see database_io.cpp: head of 48 bytes, ids, scales, checksum, pages.
constexpr std::size_t kImages = 3, kWords = 130;  // three pages, of which the last has two words
constexpr std::size_t kIds = 48, kScales = kIds + 8 * kImages, kPages = kScales + 4 * kImages + 8;
constexpr std::size_t kTable = kPages + 8, kLists = kTable + 512;

Database small_database() {
  Database database(kWords, Scoring::kL2);
  for (std::uint64_t id = 0; id < kImages; ++id) {
    BowVector bow;
    bow.push_back(0, 1.0);
    if (id == 1) bow.push_back(5, 0.25);
    if (id == 2) bow.push_back(129, 0.5);
    database.add(10 + id, bow);
  }
  return database;
}

template <typename T>
void put(Bytes& bytes, std::size_t at, T value) {
  std::memcpy(bytes.data() + at, &value, sizeof(value));
}

template <typename T>
T get(const Bytes& bytes, std::size_t at) {
  T value;
  std::memcpy(&value, bytes.data() + at, sizeof(value));
  return value;
}

// Makes all checksums right again.
void seal(Bytes& bytes) {
  put(bytes, 40, checksum(bytes.data(), 40));
  put(bytes, kPages - 8,
      checksum(bytes.data() + kScales, 4 * kImages, checksum(bytes.data() + kIds, 8 * kImages)));
  const auto size = get<std::uint32_t>(bytes, kPages);
  if (kTable + size <= bytes.size())
    put(bytes, kPages + 4, static_cast<std::uint32_t>(checksum(bytes.data() + kTable, size)));
}

void expect_refused(const Bytes& bytes, const std::string& what) {
  try {
    Database::deserialize(bytes, "somewhere");
    ADD_FAILURE() << "was read, expected: " << what;
  } catch (const IoError& error) {
    const std::string message = error.what();
    EXPECT_NE(message.find(what), std::string::npos) << message;
    EXPECT_NE(message.find("somewhere"), std::string::npos) << message;
  }
}

void expect_refused_when(const std::function<void(Bytes&)>& damage, const std::string& what) {
  Bytes bytes = small_database().serialize();
  damage(bytes);
  seal(bytes);
  expect_refused(bytes, what);
}

TEST(DatabaseFile, GivesBackWhatWasSaved) {
  Database database(5000, Scoring::kBhattacharyya);
  for (std::uint64_t i = 0; i < 300; ++i)
    database.add(i * 3, random_bow(i + 1, 100, 5000, Norm::kL1));
  for (std::uint64_t i = 0; i < 30; ++i) database.remove(i * 9);
  const std::string path = dynslam::testing::temp_path("a.dynbow");
  database.save(path);
  const Database read = Database::load(path);
  EXPECT_EQ(read.words(), 5000u);
  EXPECT_EQ(read.scoring(), Scoring::kBhattacharyya);
  EXPECT_EQ(read.ids(), database.ids());
  const BowVector query = random_bow(5, 100, 5000, Norm::kL1);
  const auto a = database.query(query), b = read.query(query);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].id, b[i].id);
    EXPECT_EQ(a[i].score, b[i].score);
  }
  EXPECT_EQ(read.serialize(), database.serialize());
}

TEST(DatabaseFile, CanBeAddedToAfterReading) {
  Database whole(500), half(500);
  for (std::uint64_t i = 0; i < 100; ++i) {
    const BowVector bow = random_bow(i + 1, 300, 500, Norm::kL1);
    whole.add(i, bow);
    if (i == 50) half = Database::deserialize(half.serialize());
    half.add(i, bow);
  }
  EXPECT_EQ(whole.serialize(), half.serialize());
}

TEST(DatabaseFile, OfAnEmptyDatabaseIsRead) {
  const Database read = Database::deserialize(Database(7).serialize());
  EXPECT_TRUE(read.empty());
  EXPECT_EQ(read.words(), 7u);
}

TEST(DatabaseFile, LeavesNoHalfFileWhereItCannotBeWritten) {
  EXPECT_THROW(small_database().save("no_such_folder/file.dynbow"), IoError);
}

TEST(DatabaseFile, ThatIsMissingIsAnError) {
  EXPECT_THROW(Database::load("no_such_file.dynbow"), IoError);
}

TEST(DatabaseFile, CutAnywhereIsRefused) {
  const Bytes whole = small_database().serialize();
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const Bytes part(whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_THROW(Database::deserialize(part), IoError) << size;
  }
}

TEST(DatabaseFile, WithAnyByteChangedIsRefused) {
  const Bytes whole = small_database().serialize();
  for (std::size_t i = 0; i < whole.size(); ++i) {
    Bytes changed = whole;
    changed[i] ^= 0x10;
    EXPECT_THROW(Database::deserialize(changed), IoError) << i;
  }
}

TEST(DatabaseFile, WithABrokenHeadIsRefusedByName) {
  expect_refused_when([](Bytes& b) { b[0] = 'D'; }, "does not start with");
  expect_refused_when([](Bytes& b) { put(b, 8, 2U); }, "version 2");
  expect_refused_when([](Bytes& b) { put(b, 12, 0x04030201U); }, "byte order");
  expect_refused_when([](Bytes& b) { put(b, 16, std::uint64_t{0}); }, "0 words");
  expect_refused_when([](Bytes& b) { put(b, 16, std::uint64_t{1} << 32); }, "4294967296 words");
  expect_refused_when([](Bytes& b) { put(b, 16, std::uint64_t{0xFFFFFFFF}); }, "do not fit");
  expect_refused_when([](Bytes& b) { put(b, 24, ~std::uint64_t{0}); }, "do not fit");
  expect_refused_when([](Bytes& b) { put(b, 24, std::uint64_t{1} << 31); }, "do not fit");
  expect_refused_when([](Bytes& b) { put(b, 32, 6U); }, "scoring 6");
  expect_refused_when([](Bytes& b) { put(b, 36, 1U); }, "reserved");
}

TEST(DatabaseFile, WithBrokenImagesIsRefusedByName) {
  expect_refused_when([](Bytes& b) { put(b, kIds + 8, std::uint64_t{10}); }, "id 10 occurs twice");
  expect_refused_when([](Bytes& b) { put(b, kScales, 0x7FC00000U); }, "scale of image 0");
  expect_refused_when([](Bytes& b) { put(b, kScales + 4, -1.0F); }, "scale of image 1");
  expect_refused_when([](Bytes& b) { put(b, kScales + 8, 0x7F800000U); }, "scale of image 2");
  Bytes bytes = small_database().serialize();
  put(bytes, kIds, std::uint64_t{77});
  expect_refused(bytes, "checksum of the images");
}

TEST(DatabaseFile, WithBrokenPagesIsRefusedByName) {
  expect_refused_when([](Bytes& b) { put(b, kPages, 0x7FFFFFFFU); }, "page 0: cut off");
  expect_refused_when([](Bytes& b) { put(b, kPages, 100U); }, "shorter than its table");
  expect_refused_when([](Bytes& b) { put(b, kTable, 4000U); }, "ends before it begins");
  expect_refused_when([](Bytes& b) { put(b, kTable + 4 * 63, 4000U); }, "do not fill");
  expect_refused_when([](Bytes& b) { b.push_back(0); }, "1 bytes after its end");
  Bytes bytes = small_database().serialize();
  bytes[kLists] ^= 1;
  expect_refused(bytes, "page 0: the checksum");
}

TEST(DatabaseFile, SeedsOfTheFuzzerAreSound) {
  for (const char* name : {"empty", "three_images", "long_list", "far_apart"}) {
    const Database database = Database::load(
        std::string(DYNSLAM_TEST_DATA_DIR "/../../fuzz/corpus/database_fuzz/") + name);
    EXPECT_EQ(Database::deserialize(database.serialize()).ids(), database.ids());
  }
}

// The first list: images 0, 1, 2 with a weight of 1, three bytes each.
TEST(DatabaseFile, WithBrokenListsIsRefusedByName) {
  const auto head = [](std::uint32_t code, std::uint32_t extra) {
    return static_cast<std::uint16_t>(code << 2 | extra);
  };
  expect_refused_when([&](Bytes& b) { put(b, kLists, head(1023, 0)); }, "out of bounds");
  expect_refused_when([&](Bytes& b) { put(b, kLists, head((15U << 10) + 1, 0)); }, "out of bounds");
  expect_refused_when([&](Bytes& b) { put(b, kLists + 6, head(15U << 10, 3)); }, "is cut off");
  expect_refused_when([&](Bytes& b) { b[kLists + 5] = 0; }, "not ascending");
  expect_refused_when([&](Bytes& b) { b[kLists + 8] = 2; }, "does not exist");
  expect_refused_when([&](Bytes& b) { put(b, kLists + 6, std::uint16_t{0}); }, "in the middle");
  expect_refused_when([&](Bytes& b) { put(b, kTable + 256, 1U); }, "with its last image");
  expect_refused_when([&](Bytes& b) { put(b, kLists, std::uint16_t{0}); }, "is empty");
  // Word 129 becomes word 130, which there is not: its list in the third page moves on by one.
  Bytes bytes = small_database().serialize();
  const std::size_t page = bytes.size() - 512 - 3;
  put(bytes, page + 4, 0U);
  put(bytes, page + 256 + 8, get<std::uint32_t>(bytes, page + 256 + 4));
  put(bytes, page - 4, static_cast<std::uint32_t>(checksum(bytes.data() + page, 515)));
  expect_refused(bytes, "beyond the last one");
}

}  // namespace
}  // namespace dynslam::loop
