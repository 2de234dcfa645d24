#include "dynslam/evaluation/trajectory_io.hpp"

#include <clocale>
#include <limits>

#include <gtest/gtest.h>
#include <sys/stat.h>

#include "dynslam/core/errors.hpp"

#include "evaluation/support.hpp"
#include "temp_folder.hpp"

namespace dynslam::evaluation {
namespace {

using dynslam::testing::TempFolder;
using testing::message_of;

constexpr const char* kKittiRow = "1 0 0 1.5 0 1 0 2.5 0 0 1 3.5\n";

Trajectory parse(const std::string& text, const ReadTrajectoryOptions& options = {}) {
  return parse_trajectory(text, "f.txt", options);
}

std::string failure(const std::string& text, const ReadTrajectoryOptions& options = {}) {
  return message_of<IoError>([&] { parse(text, options); });
}

TEST(TrajectoryIo, ReadsTumRows) {
  const Trajectory t = parse("1.5 1 2 3 0 0 0.7071068 0.7071068\n2.5 4 5 6 0 0 0 1\n");
  ASSERT_EQ(t.size(), 2u);
  EXPECT_EQ(t[0].timestamp, 1.5);
  EXPECT_EQ(t[0].T_world_cam.t, Eigen::Vector3d(1, 2, 3));
  // A quarter turn about z takes x to y.
  EXPECT_LT((t[0].T_world_cam.R * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(),
            1e-12);
  EXPECT_TRUE(t[1].T_world_cam.R.isIdentity(1e-15));
}

TEST(TrajectoryIo, ReadsKittiRowsWithTheFrameNumberAsTime) {
  const Trajectory t = parse(std::string(kKittiRow) + kKittiRow);
  ASSERT_EQ(t.size(), 2u);
  EXPECT_EQ(t[1].timestamp, 1.0);
  EXPECT_EQ(t[1].T_world_cam.t, Eigen::Vector3d(1.5, 2.5, 3.5));
}

TEST(TrajectoryIo, SkipsCommentsBlankLinesCarriageReturnsAndAByteOrderMark) {
  const Trajectory t = parse(
      "\xEF\xBB\xBF# head\r\n\r\n   \t\r\n1 0 0 0 0 0 0 1 # tail\r\n#\n2,0,0,0,0,0,0,1\r\n3\t0 , 0 "
      "0 "
      "0 0 0 +1");
  ASSERT_EQ(t.size(), 3u);
  EXPECT_EQ(t[2].timestamp, 3.0);
}

TEST(TrajectoryIo, ReadsPointsAsDecimalsInEveryLocale) {
  const std::string before = std::setlocale(LC_ALL, nullptr);
  for (const char* name : {"de_DE.UTF-8", "fr_FR.UTF-8", "C.UTF-8", "C"}) {
    if (!std::setlocale(LC_ALL, name)) continue;
    EXPECT_EQ(parse("0.25 1.5 0 0 0 0 0 1\n")[0].T_world_cam.t.x(), 1.5) << name;
  }
  std::setlocale(LC_ALL, before.c_str());
}

TEST(TrajectoryIo, NormalizesRoundedRotations) {
  const Trajectory tum = parse("1 0 0 0 0.6453 -0.5498 0.3363 -0.4101\n");
  const Eigen::Matrix3d R = tum[0].T_world_cam.R;
  EXPECT_TRUE((R.transpose() * R).isIdentity(1e-14));
  const Trajectory kitti = parse("0.999 0.001 0 1 0 1.001 0 2 0 0 1 3\n");
  const Eigen::Matrix3d Q = kitti[0].T_world_cam.R;
  EXPECT_TRUE((Q.transpose() * Q).isIdentity(1e-14));
}

TEST(TrajectoryIo, TakesKittiTimesFromTheirOwnFile) {
  const TempFolder folder;
  testing::write(folder.file("times.txt"), "0.0\n1.036224e-01\n");
  ReadTrajectoryOptions options;
  options.times_path = folder.file("times.txt");
  const Trajectory t = parse(std::string(kKittiRow) + kKittiRow, options);
  EXPECT_EQ(t[1].timestamp, 0.1036224);
}

TEST(TrajectoryIo, NamesPathLineAndExpectationInEveryError) {
  const std::string ok = "1 0 0 0 0 0 0 1\n";
  EXPECT_EQ(failure(""), "f.txt: no poses, expected at least one row of numbers");
  EXPECT_EQ(failure("# only\n\n"), "f.txt: no poses, expected at least one row of numbers");
  EXPECT_EQ(failure("\n1 2 3\n"),
            "f.txt:2: 3 numbers, expected 8 numbers (TUM: time tx ty tz qx qy qz qw) or 12 numbers "
            "(KITTI: a 3x4 matrix by rows)");
  EXPECT_EQ(failure(ok + "2 0 0 0 0 0 1\n"),
            "f.txt:2: 7 numbers, expected 8 numbers (TUM: time tx ty tz qx qy qz qw)");
  EXPECT_EQ(failure(kKittiRow + ok),
            "f.txt:2: 8 numbers, expected 12 numbers (KITTI: a 3x4 matrix by rows)");
  EXPECT_EQ(failure("1 0 0 x1 0 0 0 1\n"),
            "f.txt:1: \"x1\" is not a number, expected numbers separated by blanks or commas");
  EXPECT_EQ(failure("1 0 0 0.5.5 0 0 0 1\n"),
            "f.txt:1: \"0.5.5\" is not a number, expected numbers separated by blanks or commas");
  EXPECT_EQ(failure("1 0 0 nan 0 0 0 1\n"),
            "f.txt:1: \"nan\" is not finite, expected finite numbers");
  EXPECT_EQ(failure("inf 0 0 0 0 0 0 1\n"),
            "f.txt:1: \"inf\" is not finite, expected finite numbers");
  EXPECT_EQ(failure("1 0 0 1e999 0 0 0 1\n"),
            "f.txt:1: \"1e999\" is out of range, expected a number that fits a double");
  EXPECT_EQ(failure(ok + "2 0 0 0 0 0 0 0\n"),
            "f.txt:2: zero quaternion, expected a unit quaternion qx qy qz qw");
  EXPECT_EQ(failure("1 0 0 0 0 0 0 1.5\n"),
            "f.txt:1: quaternion of length 1.5, expected a unit quaternion qx qy qz qw (within "
            "0.01)");
  EXPECT_NE(failure("1 0 0 0 0 1 0 0 0 0 1.5 0\n").find("f.txt:1: a matrix that is no rotation"),
            std::string::npos);
  EXPECT_NE(failure("1 0 0 0 0 1 0 0 0 0 -1 0\n").find("no rotation"), std::string::npos)
      << "a reflection";
}

TEST(TrajectoryIo, NamesBothLinesOfTimestampsOutOfOrder) {
  const std::string text = "2 0 0 0 0 0 0 1\n# c\n1.5 0 0 0 0 0 0 1\n";
  EXPECT_EQ(
      failure(text),
      "f.txt:3: timestamp 1.5 runs behind 2 of line 1, expected increasing timestamps (reading "
      "with the option sort puts them in order)");
  EXPECT_EQ(failure("2 0 0 0 0 0 0 1\n\n2 1 0 0 0 0 0 1\n"),
            "f.txt:3: timestamp 2 repeats that of line 1, expected every timestamp once (reading "
            "with drop_repeated keeps the first)");
}

TEST(TrajectoryIo, SortsAndDropsRepeatedTimestampsWhenAsked) {
  const std::string text = "2 1 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n2 3 0 0 0 0 0 1\n";
  ReadTrajectoryOptions options;
  options.sort = true;
  EXPECT_NE(failure(text, options).find("f.txt:3: timestamp 2 repeats that of line 1"),
            std::string::npos);
  options.drop_repeated = true;
  const Trajectory t = parse(text, options);
  ASSERT_EQ(t.size(), 2u);
  EXPECT_EQ(t[0].T_world_cam.t.x(), 2.0);
  EXPECT_EQ(t[1].T_world_cam.t.x(), 1.0) << "the first of the equal ones";
  options.sort = false;
  EXPECT_NE(failure(text, options).find("runs behind"), std::string::npos);
}

TEST(TrajectoryIo, RefusesTimesThatDoNotFitThePoses) {
  const TempFolder folder;
  ReadTrajectoryOptions options;
  options.times_path = folder.file("times.txt");
  const std::string two = std::string(kKittiRow) + kKittiRow;
  const auto with_times = [&](const std::string& times) {
    testing::write(options.times_path, times);
    return failure(two, options);
  };
  EXPECT_EQ(with_times("1\n"),
            options.times_path + ": 1 timestamps, expected 2, one for each pose of f.txt");
  EXPECT_EQ(with_times("1\n2 3\n"),
            options.times_path + ":2: 2 numbers, expected one timestamp in seconds");
  EXPECT_EQ(with_times("2\n1\n").find(options.times_path + ":2: timestamp 1 runs behind 2"), 0u);
  testing::write(options.times_path, "1\n");
  EXPECT_NE(failure("1 0 0 0 0 0 0 1\n", options).find("expected KITTI poses"), std::string::npos);
}

TEST(TrajectoryIo, ChecksItsOptions) {
  ReadTrajectoryOptions options;
  options.rotation_tolerance = -0.1;
  EXPECT_THROW(parse("1 0 0 0 0 0 0 1\n", options), InvalidArgument);
  options.rotation_tolerance = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.format = TrajectoryFormat::kTum;
  options.times_path = "times.txt";
  EXPECT_THROW(options.validate(), InvalidArgument);
}

TEST(TrajectoryIo, KeepsToTheFormatItIsTold) {
  ReadTrajectoryOptions options;
  options.format = TrajectoryFormat::kTum;
  EXPECT_NE(failure(kKittiRow, options).find("12 numbers, expected 8"), std::string::npos);
  options.format = TrajectoryFormat::kKitti;
  EXPECT_NE(failure("1 0 0 0 0 0 0 1\n", options).find("8 numbers, expected 12"),
            std::string::npos);
}

TEST(TrajectoryIo, SurvivesBytesThatAreNoTrajectory) {
  std::mt19937 random(5);
  for (int round = 0; round < 300; ++round) {
    std::string bytes(random() % 200, '\0');
    const std::string alphabet("0123456789.-+eEnaif ,\t\n#\0\xff", 26);
    for (char& c : bytes) c = alphabet[random() % alphabet.size()];
    EXPECT_THROW(parse(bytes), IoError) << bytes;
  }
  EXPECT_NE(failure(std::string("1 \xff\x01\0", 5)).find("\"???\" is not a number"),
            std::string::npos)
      << "messages stay printable";
}

TEST(TrajectoryIo, ReadsBackWhatItWroteAsTum) {
  const TempFolder folder;
  std::mt19937 random(1);
  Trajectory walk = testing::random_walk(random, 50);
  walk[3].timestamp = 100.312345678;
  for (StampedPose& pose : walk) pose.timestamp += 1.4e9;
  write_trajectory(folder.file("t.txt"), walk);
  const Trajectory again = read_trajectory(folder.file("t.txt"));
  ASSERT_EQ(again.size(), walk.size());
  for (std::size_t i = 0; i < walk.size(); ++i) {
    EXPECT_EQ(again[i].timestamp, walk[i].timestamp) << "timestamps come back bit for bit";
    EXPECT_LT((again[i].T_world_cam.matrix() - walk[i].T_world_cam.matrix()).norm(), 1e-8);
  }
  EXPECT_EQ(testing::read(folder.file("t.txt")).find("# timestamp tx ty tz qx qy qz qw\n"), 0u);
}

TEST(TrajectoryIo, ReadsBackWhatItWroteAsKitti) {
  const TempFolder folder;
  std::mt19937 random(2);
  const Trajectory walk = testing::random_walk(random, 20);
  write_trajectory(folder.file("k.txt"), walk, TrajectoryFormat::kKitti);
  write_times(folder.file("times.txt"), walk);
  ReadTrajectoryOptions options;
  options.times_path = folder.file("times.txt");
  const Trajectory again = read_trajectory(folder.file("k.txt"), options);
  ASSERT_EQ(again.size(), walk.size());
  for (std::size_t i = 0; i < walk.size(); ++i) {
    EXPECT_EQ(again[i].timestamp, walk[i].timestamp);
    EXPECT_LT((again[i].T_world_cam.matrix() - walk[i].T_world_cam.matrix()).norm(), 1e-8);
  }
}

TEST(TrajectoryIo, WritesTimestampsWithoutAnExponent) {
  const TempFolder folder;
  write_times(folder.file("t"), Trajectory{{1e9, {}}, {1403636579763555584e-9, {}}, {1e22, {}}});
  EXPECT_EQ(testing::read(folder.file("t")),
            "1000000000\n1403636579.7635555\n10000000000000000000000\n");
}

TEST(TrajectoryIo, RefusesToWriteWhatIsNotFinite) {
  const TempFolder folder;
  Trajectory t(2);
  t[1].T_world_cam.t.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(write_trajectory(folder.file("t"), t), InvalidArgument);
  t[1] = {std::numeric_limits<double>::infinity(), {}};
  EXPECT_THROW(write_trajectory(folder.file("t"), t), InvalidArgument);
  EXPECT_THROW(write_times(folder.file("t"), t), InvalidArgument);
  EXPECT_THROW(write_trajectory(folder.file("t"), t, TrajectoryFormat::kAuto), InvalidArgument);
  EXPECT_EQ(folder.entries(), 0u) << "nothing is left behind";
}

TEST(TrajectoryIo, LeavesTheOldFileWhenWritingFails) {
  const TempFolder folder;
  testing::write(folder.file("t"), "old");
  Trajectory bad(1);
  bad[0].T_world_cam.t.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(write_trajectory(folder.file("t"), bad), InvalidArgument);
  EXPECT_EQ(testing::read(folder.file("t")), "old");
  write_trajectory(folder.file("t"), Trajectory(1));
  EXPECT_EQ(read_trajectory(folder.file("t")).size(), 1u);
  EXPECT_EQ(folder.entries(), 1u) << "no temporary file stays";
}

TEST(TrajectoryIo, WritesThroughSymbolicLinks) {
  const TempFolder folder;
  testing::write(folder.file("real"), "old");
  std::filesystem::create_symlink("real", folder.file("link"));
  write_trajectory(folder.file("link"), Trajectory(1));
  EXPECT_TRUE(std::filesystem::is_symlink(folder.file("link")));
  EXPECT_EQ(read_trajectory(folder.file("real")).size(), 1u);
}

TEST(TrajectoryIo, ReportsFilesThatCannotBeReadOrWritten) {
  const TempFolder folder;
  const std::string missing = folder.file("no/such.txt");
  EXPECT_EQ(message_of<IoError>([&] {
              read_trajectory(missing);
            }).find(missing + ": there is no such file"),
            0u);
  EXPECT_THROW(read_trajectory(folder.path().string()), IoError) << "a folder";
  EXPECT_EQ(message_of<IoError>([&] {
              write_trajectory(missing, Trajectory(1));
            }).find(missing + ": cannot be written"),
            0u);
  EXPECT_THROW(write_trajectory(folder.path().string(), Trajectory(1)), IoError) << "a folder";
  if (std::filesystem::exists("/dev/full")) {
    EXPECT_THROW(write_trajectory("/dev/full", Trajectory(1)), IoError) << "the disk is full";
    EXPECT_TRUE(std::filesystem::is_character_file("/dev/full")) << "the device is still there";
  }
}

TEST(TrajectoryIo, ReadsTheTrajectoriesOfKnownSystems) {
  const std::string folder = testing::trajectories_folder();
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no data in " << folder;
  EXPECT_EQ(read_trajectory(folder + "KITTI_00_gt.txt").size(), 4541u);
  EXPECT_EQ(read_trajectory(folder + "freiburg1_xyz-groundtruth.txt").size(), 3000u);
  EXPECT_EQ(read_trajectory(folder + "freiburg1_xyz-rgbdslam.txt").size(), 788u);
  const std::string desk = folder + "fr2_desk_groundtruth.txt";
  EXPECT_NE(message_of<IoError>([&] { read_trajectory(desk); }).find(":10863: timestamp"),
            std::string::npos);
  ReadTrajectoryOptions options;
  options.drop_repeated = true;
  EXPECT_EQ(read_trajectory(desk, options).size(), 20956u);
}

}  // namespace
}  // namespace dynslam::evaluation
