#include "dynslam/dataset/parsing.hpp"

#include <algorithm>
#include <clocale>
#include <cmath>
#include <limits>
#include <locale>
#include <random>

#include <gtest/gtest.h>

#include "dataset/tiny_folders.hpp"

namespace dynslam::dataset {
namespace {

using testing::holds;
using testing::io_error_of;

TEST(ParseTumImages, TakesCommentsBlankLinesTabsCarriageReturnsAndAByteOrderMark) {
  const auto rows = parse_tum_images(
      "\xEF\xBB\xBF# color images\r\n\r\n 1.5\trgb/a.png \r\n#x\n+2e0 rgb/b.png", "f");
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_EQ(rows[0].timestamp, 1.5);
  EXPECT_EQ(rows[0].file, "rgb/a.png");
  EXPECT_EQ(rows[0].line, 3U);
  EXPECT_EQ(rows[1].timestamp, 2.0);
  EXPECT_EQ(rows[1].line, 5U);
}

TEST(ParseTumImages, AnEmptyTextHasNoRows) {
  EXPECT_TRUE(parse_tum_images("", "f").empty());
  EXPECT_TRUE(parse_tum_images("# only a comment", "f").empty());
  EXPECT_TRUE(parse_tum_images("\n\n  \n", "f").empty());
}

TEST(ParseTumImages, NamesPathLineFieldAndWhatWasExpected) {
  const std::string message =
      io_error_of([] { parse_tum_images("1 a.png\n\n1,5 b.png\n", "dir/rgb.txt"); });
  EXPECT_EQ(message, "dir/rgb.txt:3: the time is \"1,5\", expected a finite number");
}

TEST(ParseTumImages, RefusesAnotherNumberOfFields) {
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_images("1\n", "f"); }), "f:1: got 1 fields"));
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_images("1 a b\n", "f"); }), "f:1: got 3 fields"));
}

TEST(ParseNumbers, RefusesWhatIsNoFiniteDecimalNumber) {
  for (const char* bad : {"nan", "inf", "-inf", "1e999", "0x10", "1.5.2", "1e", "--1", "+-1", "abc",
                          "1;", "1_000", "\x01", "."}) {
    EXPECT_TRUE(holds(io_error_of([&] { parse_tum_images(std::string(bad) + " a.png", "f"); }),
                      "expected a finite number"))
        << bad;
  }
}

TEST(ParseNumbers, TakesEveryUsualWayToWriteANumber) {
  for (const auto& [text, value] :
       {std::pair("1.", 1.0), std::pair(".5", 0.5), std::pair("-0", 0.0),
        std::pair("1.5E+03", 1500.0), std::pair("1e-999", 0.0), std::pair("+.5", 0.5),
        std::pair("007", 7.0)}) {
    EXPECT_EQ(parse_tum_images(std::string(text) + " a.png", "f")[0].timestamp, value) << text;
  }
}

TEST(ParseNumbers, ShortensAndCleansForeignBytesInItsMessage) {
  const std::string field(1000, '\x1b');
  const std::string message = io_error_of([&] { parse_tum_images(field + " a", "f"); });
  EXPECT_LT(message.size(), 150U);
  EXPECT_EQ(message.find('\x1b'), std::string::npos);
}

struct CommaNumbers : std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
};

TEST(ParseNumbers, DoNotDependOnTheLocale) {
  const std::locale before = std::locale::global(std::locale(std::locale(), new CommaNumbers));
  const std::string c_before = std::setlocale(LC_NUMERIC, nullptr);
  for (const char* name : {"de_DE.UTF-8", "de_DE", "fr_FR.UTF-8"}) {
    if (std::setlocale(LC_NUMERIC, name) != nullptr) break;
  }
  const auto rows = parse_tum_images("1.25 a.png", "f");
  const CameraFile camera = parse_camera("fx 1.5 fy 2.5 cx 0.5 cy 0.25", "f");
  std::setlocale(LC_NUMERIC, c_before.c_str());
  std::locale::global(before);
  EXPECT_EQ(rows[0].timestamp, 1.25);
  EXPECT_EQ(camera.camera.fx, 1.5);
}

TEST(ParseTumAssociations, KeepsBothTimesAndFiles) {
  const auto rows = parse_tum_associations("1.0 rgb/a.jpg 1.01 depth/b.png\n", "f");
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].color.file, "rgb/a.jpg");
  EXPECT_EQ(rows[0].depth.timestamp, 1.01);
  EXPECT_EQ(rows[0].depth.file, "depth/b.png");
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_associations("1 a 1\n", "f"); }), "got 3 fields"));
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_associations("1 a x b\n", "f"); }), "depth image"));
}

TEST(ParseTumPoses, ReadsPositionAndQuaternionInTheOrderXyzw) {
  const auto rows = parse_tum_poses("5 1 2 3 0 0 0.70710678 0.70710678\n", "f");
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].pose.T_world_cam.t, Eigen::Vector3d(1, 2, 3));
  const Eigen::Vector3d turned = rows[0].pose.T_world_cam.R * Eigen::Vector3d::UnitX();
  EXPECT_LT((turned - Eigen::Vector3d::UnitY()).norm(), 1e-7);
}

TEST(ParseTumPoses, RefusesNaNAndAQuaternionThatIsNoRotation) {
  EXPECT_EQ(io_error_of([] { parse_tum_poses("# t\n1 0 nan 0 0 0 0 1\n", "g.txt"); }),
            "g.txt:2: ty is \"nan\", expected a finite number");
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_poses("1 0 0 0 0 0 0 0\n", "f"); }), "norm is 0"));
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_poses("1 0 0 0 0 0 0 2\n", "f"); }), "norm is 2"));
  EXPECT_TRUE(holds(io_error_of([] { parse_tum_poses("1 0 0 0 0 0 1\n", "f"); }), "got 7 fields"));
}

TEST(ParseCamera, ReadsKeysInAnyOrderOverSeveralLines) {
  const CameraFile file = parse_camera(
      "# mine\ncy 240 cx 320\nfx 525 fy 520 width 640 height 480\nk1 0.1 p2 -0.2 bf 40 fps 15 "
      "depth_scale 1000\n",
      "f");
  EXPECT_EQ(file.camera.fx, 525.0);
  EXPECT_EQ(file.camera.fy, 520.0);
  EXPECT_EQ(file.camera.cx, 320.0);
  EXPECT_EQ(file.camera.cy, 240.0);
  EXPECT_EQ(file.camera.width, 640);
  EXPECT_EQ(file.camera.height, 480);
  EXPECT_EQ(file.camera.bf, 40.0);
  EXPECT_EQ(file.fps, 15.0);
  EXPECT_EQ(file.depth_scale, 1000.0);
  EXPECT_EQ(file.distortion, (Distortion{0.1, 0.0, 0.0, -0.2, 0.0}));
}

TEST(ParseCamera, LeavesTheBaselineVirtualAndTheRestOpen) {
  const CameraFile file = parse_camera("fx 1050 fy 1050 cx 1 cy 2", "f");
  EXPECT_DOUBLE_EQ(file.camera.bf, 80.0);
  EXPECT_EQ(file.camera.width, 0);
  EXPECT_FALSE(file.fps);
  EXPECT_FALSE(file.depth_scale);
  EXPECT_EQ(file.distortion, Distortion{});
}

TEST(ParseCamera, RefusesWhatItDoesNotKnowNeedsOrCannotUse) {
  const auto says = [](const std::string& text, const std::string& part) {
    return holds(io_error_of([&] { parse_camera(text, "camera.txt"); }), part);
  };
  const std::string good = "fx 1 fy 1 cx 1 cy 1 ";
  EXPECT_TRUE(says("", "camera.txt: the camera is incomplete"));
  EXPECT_TRUE(says("fx 1 fy 1 cx 1", "incomplete"));
  EXPECT_TRUE(says(good + "fx 2", "camera.txt:1: fx is given twice"));
  EXPECT_TRUE(says(good + "fps 2 fps 2", "fps is given twice"));
  EXPECT_TRUE(says(good + "width 2\nwidth 3", "camera.txt:2: width is given twice"));
  EXPECT_TRUE(says(good + "focal 2", "unknown key \"focal\""));
  EXPECT_TRUE(says(good + "fps", "odd number of fields"));
  EXPECT_TRUE(says("fx -1 fy 1 cx 1 cy 1", "fx is -1"));
  EXPECT_TRUE(says("fx 1 fy 0 cx 1 cy 1", "fy is 0"));
  EXPECT_TRUE(says("fx 1 fy 1 cx nan cy 1", "\"cx\" is \"nan\""));
  EXPECT_TRUE(says(good + "width 0", "width is 0"));
  EXPECT_TRUE(says(good + "height 1.5", "height is 1.5"));
  EXPECT_TRUE(says(good + "width 1e9", "from 1 to 65535"));
  EXPECT_TRUE(says(good + "depth_scale 0", "depth_scale is 0"));
  EXPECT_TRUE(says(good + "bf -1", "bf is -1"));
}

TEST(KnownTumCamera, IsFoundByThePublishedNamesOnly) {
  EXPECT_EQ(known_tum_camera("rgbd_dataset_freiburg1_desk")->camera.fx, 517.3);
  EXPECT_EQ(known_tum_camera("rgbd_dataset_freiburg2_xyz")->distortion[4], 0.9172);
  const auto fr3 = known_tum_camera("rgbd_dataset_freiburg3_walking_xyz");
  EXPECT_EQ(fr3->camera.fy, 539.2);
  EXPECT_EQ(fr3->distortion, Distortion{});
  EXPECT_EQ(known_tum_camera("rgbd_bonn_balloon")->camera.cx, 315.593520);
  EXPECT_FALSE(known_tum_camera("my_rgbd_bonn_balloon"));
  EXPECT_FALSE(known_tum_camera("kitchen"));
  EXPECT_FALSE(known_tum_camera(""));
}

TEST(ParseKittiCalibration, TakesBareAndLabelledLines) {
  const std::string P0 = "700 0 600 0 0 700 180 0 0 0 1 0\n";
  const std::string P1 = "700 0 600 -380 0 700 180 0 0 0 1 0\n";
  const auto bare = parse_kitti_calibration(P0 + P1, "calib.txt");
  const auto labelled = parse_kitti_calibration("Tr: 1 2 3\nP1: " + P1 + "P0: " + P0, "calib.txt");
  for (const auto& calibration : {bare, labelled}) {
    EXPECT_EQ((*calibration.P[0])(0, 2), 600.0);
    EXPECT_EQ((*calibration.P[1])(0, 3), -380.0);
    EXPECT_FALSE(calibration.P[2]);
  }
}

TEST(ParseKittiCalibration, RefusesIncompleteRepeatedAndImpossibleMatrices) {
  const auto says = [](const std::string& text, const std::string& part) {
    return holds(io_error_of([&] { parse_kitti_calibration(text, "calib.txt"); }), part);
  };
  EXPECT_TRUE(says("", "calib.txt: there is no matrix P0"));
  EXPECT_TRUE(says("P0: 1 2 3", "calib.txt:1: got 4 fields"));
  EXPECT_TRUE(says("P0: 700 0 600 0 0 700 180 0 0 0 0 0", "no projection"));
  EXPECT_TRUE(says("-1 0 600 0 0 700 180 0 0 0 1 0", "no projection"));
  const std::string P0 = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\n";
  EXPECT_TRUE(says(P0 + P0, "calib.txt:2: P0 is given twice"));
  EXPECT_TRUE(says("700 0 nan 0 0 700 180 0 0 0 1 0", "finite number"));
}

TEST(ParseKittiPoses, ProjectsOntoTheRotationsAndRefusesWhatIsNone) {
  const auto poses = parse_kitti_poses("1.0000001 0 0 1 0 1 0 2 0 0 1 3\n", "f");
  ASSERT_EQ(poses.size(), 1U);
  EXPECT_LT((poses[0].R - Eigen::Matrix3d::Identity()).norm(), 1e-12);
  EXPECT_EQ(poses[0].t, Eigen::Vector3d(1, 2, 3));
  const auto says = [](const std::string& text, const std::string& part) {
    return holds(io_error_of([&] { parse_kitti_poses(text, "f"); }), part);
  };
  EXPECT_TRUE(says("2 0 0 1 0 1 0 2 0 0 1 3", "no rotation"));
  EXPECT_TRUE(says("-1 0 0 1 0 1 0 2 0 0 1 3", "no rotation"));  // a reflection
  EXPECT_TRUE(says("0 0 0 0 0 0 0 0 0 0 0 0", "no rotation"));
  EXPECT_TRUE(says("1 0 0 1 0 1 0 2 0 0 1", "got 11 fields"));
  EXPECT_TRUE(says("nan 0 0 1 0 1 0 2 0 0 1 3", "finite"));
}

TEST(ParseKittiTimes, KeepTheirLines) {
  const auto times = parse_kitti_times("0.0e+00\n\n1.0e-01\n", "f");
  ASSERT_EQ(times.size(), 2U);
  EXPECT_EQ(times[1], std::make_pair(0.1, std::size_t{3}));
  EXPECT_THROW(parse_kitti_times("1 2\n", "f"), IoError);
}

TEST(ParseEurocImages, ReadsNanosecondsToTheMicrosecond) {
  const auto rows = parse_euroc_images(
      "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n", "f");
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_NEAR(rows[0].timestamp, 1403636579.763555584, 5e-7);
  EXPECT_EQ(rows[0].file, "1403636579763555584.png");
  EXPECT_TRUE(
      holds(io_error_of([] { parse_euroc_images("1.5,a.png", "f"); }), "whole nanoseconds"));
  EXPECT_TRUE(holds(io_error_of([] { parse_euroc_images("99999999999999999999,a", "f"); }), "f:1"));
  EXPECT_TRUE(holds(io_error_of([] { parse_euroc_images("1,", "f"); }), "name is empty"));
  EXPECT_TRUE(holds(io_error_of([] { parse_euroc_images("1", "f"); }), "got 1 fields"));
}

TEST(ParseEurocPoses, ReadsTheQuaternionInTheOrderWxyz) {
  const auto rows = parse_euroc_poses("2000000000, 1,2,3, 0.6,0,0,0.8, 9,9,9\n", "f");
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].pose.timestamp, 2.0);
  EXPECT_EQ(rows[0].pose.T_world_cam.t, Eigen::Vector3d(1, 2, 3));
  EXPECT_NEAR(rows[0].pose.T_world_cam.quaternion().z(), 0.8, 1e-12);
  EXPECT_TRUE(holds(io_error_of([] { parse_euroc_poses("1,2,3", "f"); }), "got 3 fields"));
  EXPECT_TRUE(
      holds(io_error_of([] { parse_euroc_poses("1,nan,0,0,1,0,0,0", "f"); }), "px is \"nan\""));
}

constexpr const char* kSensor = R"(%YAML:1.0
# General sensor definitions.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, 0.1,   # a comment
         1.0, 0.0, 0.0, 0.2,
         0.0, 0.0, 1.0, 0.3,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
)";

TEST(ParseEurocCamera, ReadsAPublishedFile) {
  const EurocCamera camera = parse_euroc_camera(kSensor, "sensor.yaml");
  EXPECT_EQ(camera.file.camera.fx, 458.654);
  EXPECT_EQ(camera.file.camera.cy, 248.375);
  EXPECT_EQ(camera.file.camera.width, 752);
  EXPECT_EQ(camera.file.camera.height, 480);
  EXPECT_EQ(camera.file.fps, 20.0);
  EXPECT_EQ(camera.file.distortion[3], 1.76187114e-05);
  EXPECT_EQ(camera.T_body_cam.t, Eigen::Vector3d(0.1, 0.2, 0.3));
  EXPECT_LT((camera.T_body_cam.R * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(),
            1e-9);
}

TEST(ParseEurocCamera, NamesTheKeyThatIsWrong) {
  const auto says = [](const std::string& from, const std::string& to, const std::string& part) {
    std::string text = kSensor;
    text.replace(text.find(from), from.size(), to);
    return holds(io_error_of([&] { parse_euroc_camera(text, "sensor.yaml"); }), part);
  };
  EXPECT_TRUE(says("pinhole", "omni", "sensor.yaml:13: camera_model: got \"omni\""));
  EXPECT_TRUE(says("radial-tangential", "equidistant", "distortion_model: got \"equidistant\""));
  EXPECT_TRUE(says("[752, 480]", "[752, 480, 3]", "resolution: the list has another length"));
  EXPECT_TRUE(says("[752, 480]", "[752, 0]", "whole numbers of pixels"));
  EXPECT_TRUE(says("[752, 480]", "752", "expected a list"));
  EXPECT_TRUE(says("[752, 480]", "[752, 480", "resolution:"));  // runs on into the next list
  EXPECT_TRUE(says("458.654", "nan", "intrinsics: got \"nan\""));
  EXPECT_TRUE(says("458.654", "-458", "focal lengths are not positive"));
  EXPECT_TRUE(says("rate_hz: 20", "rate_hz: 0", "rate_hz: got 0"));
  EXPECT_TRUE(says("rate_hz: 20", "rate_hz: x", "rate_hz: got \"x\""));
  EXPECT_TRUE(says("0.0, -1.0, 0.0, 0.1", "0.0, -2.0, 0.0, 0.1", "no rigid motion"));
  EXPECT_TRUE(says("intrinsics", "intrinsic", "the camera is incomplete"));
  EXPECT_TRUE(says("1.76187114e-05]", "1.76187114e-05", "the list does not end"));
}

TEST(ParseEurocCamera, IsQuickWithAListOfAMillionLines) {
  const std::string text = "intrinsics: [" + std::string(1000000, '\n');
  EXPECT_TRUE(holds(io_error_of([&] { parse_euroc_camera(text, "f"); }), "the list does not end"));
}

// What the TUM tool does, by trying all pairs.
std::vector<std::pair<std::size_t, std::size_t>> associate_slowly(const std::vector<double>& a,
                                                                  const std::vector<double>& b,
                                                                  double most) {
  std::vector<std::tuple<double, std::size_t, std::size_t>> all;
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (std::size_t j = 0; j < b.size(); ++j) {
      if (std::abs(a[i] - b[j]) <= most) all.emplace_back(std::abs(a[i] - b[j]), i, j);
    }
  }
  std::sort(all.begin(), all.end());
  std::vector<bool> used_a(a.size()), used_b(b.size());
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  for (const auto& [difference, i, j] : all) {
    if (used_a[i] || used_b[j]) continue;
    used_a[i] = used_b[j] = true;
    pairs.emplace_back(i, j);
  }
  std::sort(pairs.begin(), pairs.end(),
            [&](const auto& x, const auto& y) { return a[x.first] < a[y.first]; });
  return pairs;
}

TEST(Associate, TakesTheClosestPairOfAllFirst) {
  // 1.00 is nearer to 1.01 than 1.02 is; 1.02 then takes what is left.
  const std::vector<double> a = {1.02, 1.00}, b = {1.009, 1.045};
  const auto pairs = associate(a, b, 0.03);
  ASSERT_EQ(pairs.size(), 2U);
  EXPECT_EQ(pairs[0], std::make_pair(std::size_t{1}, std::size_t{0}));
  EXPECT_EQ(pairs[1], std::make_pair(std::size_t{0}, std::size_t{1}));
}

TEST(Associate, EqualsTheTrialOfAllPairsOnRandomTimes) {
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> time(0.0, 10.0);
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<double> a(rng() % 40), b(rng() % 40);
    for (double& t : a) t = time(rng);
    for (double& t : b) t = time(rng);
    const double most = std::pow(10.0, -3.0 + 4.0 * (trial / 200.0));
    EXPECT_EQ(associate(a, b, most), associate_slowly(a, b, most)) << trial;
  }
}

TEST(Associate, NeverPairsATimeThatIsNotFinite) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const std::vector<double> a = {nan, 1.0, inf}, b = {nan, inf, 1.0};
  const auto pairs = associate(a, b, inf);
  ASSERT_EQ(pairs.size(), 1U);
  EXPECT_EQ(pairs[0], std::make_pair(std::size_t{1}, std::size_t{2}));
  EXPECT_TRUE(associate(Span<const double>(), b, 1.0).empty());
}

TEST(Associate, IsQuickWhereAllTimesAreCloseToEachOther) {
  const std::vector<double> a(50000, 1.0), b(50000, 1.0);
  EXPECT_EQ(associate(a, b, 10.0).size(), 50000U);  // all pairs would be 2.5e9
}

TEST(Associate, RefusesANegativeOrUndefinedDifference) {
  const std::vector<double> t = {1.0};
  EXPECT_THROW(associate(t, t, -1.0), InvalidArgument);
  EXPECT_THROW(associate(t, t, std::nan("")), InvalidArgument);
}

TEST(NaturalLess, CountsAsPeopleDo) {
  std::vector<std::string> names = {"10.png", "2.png", "a10b2", "a10b10", "a9",
                                    "01.png", "1.png", "b",     ""};
  std::sort(names.begin(), names.end(), natural_less);
  EXPECT_EQ(names, (std::vector<std::string>{"", "01.png", "1.png", "2.png", "10.png", "a9",
                                             "a10b2", "a10b10", "b"}));
}

TEST(NaturalLess, OrdersNumbersLongerThanAnyInteger) {
  const std::string nines(50, '9');
  EXPECT_TRUE(natural_less(nines, "1" + nines));
  EXPECT_FALSE(natural_less("1" + nines, nines));
}

TEST(NaturalLess, IsAStrictWeakOrdering) {
  std::mt19937 rng(3);
  std::vector<std::string> words;
  for (int i = 0; i < 60; ++i) {
    std::string word;
    for (unsigned n = rng() % 5; n > 0; --n) word += "0012a."[rng() % 6];
    words.push_back(word);
  }
  for (const auto& a : words) {
    EXPECT_FALSE(natural_less(a, a));
    for (const auto& b : words) {
      EXPECT_EQ(natural_less(a, b) || natural_less(b, a), a != b) << a << " " << b;
      for (const auto& c : words) {
        if (natural_less(a, b) && natural_less(b, c)) {
          EXPECT_TRUE(natural_less(a, c)) << a << " " << b << " " << c;
        }
      }
    }
  }
}

// Whatever the bytes, a parser returns or throws IoError.
TEST(Parsers, HoldForDamagedTexts) {
  const std::vector<std::string> seeds = {
      "# c\n1.0 rgb/a.png\n2.0 rgb/b.png\n",
      "1.0 rgb/a.png 1.0 depth/a.png\n",
      "1.0 1 2 3 0 0 0 1\n",
      testing::kTinyCamera,
      "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -380 0 700 180 0 0 0 1 0\n",
      "1 0 0 1 0 1 0 2 0 0 1 3\n",
      "#t,f\n1403636579763555584,1403636579763555584.png\n",
      "2000000000,1,2,3,1,0,0,0\n",
      kSensor};
  std::mt19937 rng(11);
  const std::string alphabet = "0123456789.eE+-, \t\r\n#:[]naif\0\xff";
  int parsed = 0;
  const auto attempt = [&](auto parse, const std::string& text) {
    try {
      parse(text, "f");
      ++parsed;
    } catch (const IoError&) {
    }
  };
  for (int trial = 0; trial < 4000; ++trial) {
    std::string text = seeds[rng() % seeds.size()];
    for (unsigned n = 1 + rng() % 6; n > 0 && !text.empty(); --n) {
      const std::size_t at = rng() % text.size();
      const char c = alphabet[rng() % alphabet.size()];
      switch (rng() % 4) {
        case 0:
          text[at] = c;
          break;
        case 1:
          text.insert(at, 1, c);
          break;
        case 2:
          text.erase(at, 1 + rng() % 10);
          break;
        default:
          text.resize(at);
      }
    }
    attempt(parse_tum_images, text);
    attempt(parse_tum_associations, text);
    attempt(parse_tum_poses, text);
    attempt(parse_camera, text);
    attempt(parse_kitti_calibration, text);
    attempt(parse_kitti_times, text);
    attempt(parse_kitti_poses, text);
    attempt(parse_euroc_images, text);
    attempt(parse_euroc_poses, text);
    attempt(parse_euroc_camera, text);
  }
  EXPECT_GT(parsed, 100);  // some damage is harmless
}

}  // namespace
}  // namespace dynslam::dataset
