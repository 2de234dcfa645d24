#include "dynslam/core/files.hpp"

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "full_disk.hpp"
#include "temp_folder.hpp"

namespace dynslam {
namespace {

namespace fs = std::filesystem;

class Files : public ::testing::Test {
 protected:
  std::string file(const char* name) const { return folder_.file(name); }

  testing::TempFolder folder_;
};

std::string error_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const IoError& error) {
    return error.what();
  }
  return "";
}

TEST_F(Files, ComeBackAsTheyWereWritten) {
  std::string bytes(300000, '\0');
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 31 % 251);
  write_file_atomically(file("a"), bytes);
  EXPECT_EQ(read_file(file("a")), bytes);
  write_file_atomically(file("a"), "");
  EXPECT_EQ(read_file(file("a")), "");
  AtomicFile pieces(file("a"));
  for (std::size_t at = 0; at < bytes.size(); at += 7) {
    pieces.write(bytes.data() + at, std::min<std::size_t>(7, bytes.size() - at));
  }
  pieces.write(bytes);
  pieces.commit();
  EXPECT_EQ(read_file(file("a")), bytes + bytes);
  EXPECT_EQ(folder_.entries(), 1U) << "nothing lies beside";
}

TEST_F(Files, LeaveTheOldContentUntilCommitted) {
  write_file_atomically(file("a"), "old");
  {
    AtomicFile forgotten(file("a"));
    forgotten.write("new");
    EXPECT_EQ(read_file(file("a")), "old");
  }
  EXPECT_EQ(read_file(file("a")), "old");
  EXPECT_EQ(folder_.entries(), 1U);
}

TEST_F(Files, AFullDiskIsAnErrorAndLeavesTheOldContent) {
  write_file_atomically(file("a"), "old");
  for (const bool durable : {false, true}) {
    const testing::FullDisk full(100000);
    EXPECT_NE(error_of([&] {
                write_file_atomically(file("a"), std::string(200000, 'x'), durable);
              }).find(file("a") + ": cannot be written: "),
              std::string::npos);
  }
  EXPECT_EQ(read_file(file("a")), "old");
  EXPECT_EQ(folder_.entries(), 1U) << "nothing half written is left";
}

TEST_F(Files, ASymbolicLinkStaysOne) {
  write_file_atomically(file("real"), "old");
  fs::create_symlink(file("real"), file("link"));
  write_file_atomically(file("link"), "new");
  EXPECT_TRUE(fs::is_symlink(file("link")));
  EXPECT_EQ(read_file(file("real")), "new");
}

TEST_F(Files, DevicesAreWrittenDirectly) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "no /dev/full here";
  EXPECT_NE(error_of([] { write_file_atomically("/dev/full", "x"); }), "");
  EXPECT_TRUE(fs::is_character_file("/dev/full"));
  EXPECT_NO_THROW(write_file_atomically("/dev/null", "x"));
}

TEST_F(Files, ErrorsNameTheFile) {
  EXPECT_NE(error_of([&] { AtomicFile{file("")}; }).find("it is a folder"), std::string::npos);
  EXPECT_NE(error_of([&] { AtomicFile{file("no/a")}; }).find(file("no/a")), std::string::npos);
  EXPECT_NE(error_of([&] { read_file(file("no")); }).find(file("no") + ": there is no such file"),
            std::string::npos);
  EXPECT_NE(error_of([&] {
              read_file(folder_.path().string());
            }).find(folder_.path().string() + ": is a folder, not a file"),
            std::string::npos);
}

}  // namespace
}  // namespace dynslam
