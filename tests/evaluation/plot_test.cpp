#include "dynslam/evaluation/plot.hpp"

#include <chrono>
#include <cmath>
#include <csignal>
#include <limits>

#include <gtest/gtest.h>
#include <sys/wait.h>

#include "dynslam/core/errors.hpp"
#include "dynslam/evaluation/trajectory_plots.hpp"

#include "evaluation/support.hpp"
#include "temp_folder.hpp"

namespace dynslam::evaluation {
namespace {

using testing::kNaN;

PlotSeries line(std::vector<double> x, std::vector<double> y) {
  PlotSeries series;
  series.x = std::move(x);
  series.y = std::move(y);
  return series;
}

Plot plot_of(PlotSeries series) {
  Plot plot;
  plot.series = {std::move(series)};
  return plot;
}

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

class PlotTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (plot_svg(plot_of(line({0, 1}, {0, 1}))).status == PlotStatus::kGnuplotMissing) {
      GTEST_SKIP() << "gnuplot is not installed";
    }
  }
};

TEST_F(PlotTest, IsOneSvgElement) {
  Plot plot = plot_of(line({0, 1, 2}, {1, 4, 9}));
  plot.title = "A title";
  plot.x_label = "time (s)";
  plot.series[0].name = "a name";
  const PlotResult result = plot_svg(plot);
  ASSERT_EQ(result.status, PlotStatus::kOk) << result.problem;
  EXPECT_TRUE(result.problem.empty());
  EXPECT_EQ(result.svg.find("<svg"), 0u);
  EXPECT_EQ(result.svg.rfind("</svg>"), result.svg.size() - 6);
  for (const char* text : {"A title", "time (s)", "a name"}) {
    EXPECT_NE(result.svg.find(text), std::string::npos) << text;
  }
}

TEST_F(PlotTest, IsTheSameEveryTime) {
  const Plot plot = plot_of(line({0, 1, 2}, {1, 4, 9}));
  EXPECT_EQ(plot_svg(plot).svg, plot_svg(plot).svg);
}

TEST_F(PlotTest, TakesNamesAsTextNeverAsCommands) {
  const dynslam::testing::TempFolder folder;
  const std::string mark = folder.file("mark");
  for (const std::string& name :
       {"`touch " + mark + "`", "'; system('touch " + mark + "'); '", "\n!touch " + mark + "\n",
        "\nEND_OF_DATA\nsystem('touch " + mark + "')\n", std::string("\\' $x @y %s {/:Bold z}"),
        std::string("\xff\xfe broken \0 bytes", 17), std::string("<script>&amp;</script>")}) {
    Plot plot = plot_of(line({0, 1}, {0, 1}));
    plot.title = plot.x_label = plot.y_label = plot.value_label = plot.series[0].name = name;
    const PlotResult result = plot_svg(plot);
    EXPECT_EQ(result.status, PlotStatus::kOk) << name << ": " << result.problem;
    EXPECT_EQ(result.svg.find("<script"), std::string::npos);
  }
  EXPECT_FALSE(std::filesystem::exists(mark));
}

TEST_F(PlotTest, DrawsEveryStyle) {
  Plot plot;
  for (const PlotStyle style : {PlotStyle::kLine, PlotStyle::kDashed, PlotStyle::kPoints,
                                PlotStyle::kSegments, PlotStyle::kHeat, PlotStyle::kStacked}) {
    PlotSeries series = line({0, 1, 2, 3}, {3, 1, 4, 1});
    series.style = style;
    series.color = "#123456";
    series.name = "style " + std::to_string(static_cast<int>(style));
    series.x2 = series.y2 = series.value = {1, 2, 3, 4};
    plot.series.push_back(series);
  }
  for (const bool equal : {false, true}) {
    plot.equal_axes = equal;
    const PlotResult result = plot_svg(plot);
    ASSERT_EQ(result.status, PlotStatus::kOk) << result.problem;
    EXPECT_EQ(count(result.svg, "id=\"gnuplot_plot_"), 6u);
  }
}

TEST_F(PlotTest, OfNothingIsAnEmptyFrame) {
  EXPECT_EQ(plot_svg({}).status, PlotStatus::kOk);
  EXPECT_EQ(plot_svg(plot_of(line({}, {}))).status, PlotStatus::kOk);
  EXPECT_EQ(plot_svg(plot_of(line({kNaN, 1}, {1, kNaN}))).status, PlotStatus::kOk);
  PlotSeries heat = line({0, 1}, {0, 1});
  heat.style = PlotStyle::kHeat;
  heat.value = {kNaN, kNaN};
  EXPECT_EQ(plot_svg(plot_of(heat)).status, PlotStatus::kOk);
}

TEST_F(PlotTest, DrawsNumbersOfAnySize) {
  const double inf = std::numeric_limits<double>::infinity();
  for (const std::vector<double>& y : std::vector<std::vector<double>>{{5, 5},
                                                                       {0, 0},
                                                                       {-1e-300, 1e-300},
                                                                       {1e18, 1e18 + 1000},
                                                                       {-1e90, 1e90},
                                                                       {1e308, -1e308},
                                                                       {inf, 1}}) {
    for (const bool equal : {false, true}) {
      Plot plot = plot_of(line({1.4e9, 1.4e9 + 1}, y));
      plot.equal_axes = equal;
      const PlotResult result = plot_svg(plot);
      EXPECT_EQ(result.status, PlotStatus::kOk) << y[0] << ": " << result.problem;
    }
  }
}

TEST_F(PlotTest, KeepsThePeaksAndGapsOfLongSeries) {
  std::vector<double> x, y;
  for (int i = 0; i < 100000; ++i) {
    x.push_back(i);
    y.push_back(std::sin(1e-3 * i));
  }
  const std::size_t bytes_without = plot_svg(plot_of(line(x, y))).svg.size();
  EXPECT_LT(bytes_without, 150000u);
  y[54321] = 1000.0;
  const PlotResult peak = plot_svg(plot_of(line(x, y)));
  EXPECT_NE(peak.svg.find("<text> 1000</text>"), std::string::npos) << "the axis shows the peak";
  y[54321] = kNaN;
  const PlotResult gap = plot_svg(plot_of(line(x, y)));
  EXPECT_EQ(gap.status, PlotStatus::kOk);
  EXPECT_NE(gap.svg, plot_svg(plot_of(line(x, std::vector<double>(y.size(), 0.0)))).svg);
}

TEST_F(PlotTest, IsWrittenToAFile) {
  const dynslam::testing::TempFolder folder;
  write_plot(folder.file("p.svg"), plot_of(line({0, 1}, {0, 1})));
  const std::string text = testing::read(folder.file("p.svg"));
  EXPECT_EQ(text.find("<?xml"), 0u);
  EXPECT_NE(text.find("xmlns=\"http://www.w3.org/2000/svg\""), std::string::npos);
  EXPECT_THROW(write_plot(folder.file("no/p.svg"), {}), IoError);
}

TEST_F(PlotTest, WorksWhenTheHostIgnoresItsChildren) {
  struct sigaction ignore {
  }, before{};
  ignore.sa_handler = SIG_IGN;
  sigaction(SIGCHLD, &ignore, &before);
  const PlotResult result = plot_svg(plot_of(line({0, 1}, {0, 1})));
  sigaction(SIGCHLD, &before, nullptr);
  EXPECT_EQ(result.status, PlotStatus::kOk) << result.problem;
}

TEST(Gnuplot, MissingIsAValueThatSaysSo) {
  GnuplotOptions options;
  options.program = "no-such-gnuplot";
  const PlotResult result = plot_svg({}, options);
  EXPECT_EQ(result.status, PlotStatus::kGnuplotMissing);
  EXPECT_TRUE(result.svg.empty());
  EXPECT_NE(result.problem.find("\"no-such-gnuplot\" cannot be started"), std::string::npos);
  const dynslam::testing::TempFolder folder;
  EXPECT_THROW(write_plot(folder.file("p.svg"), {}, options), IoError);
  EXPECT_EQ(folder.entries(), 0u);
}

TEST(Gnuplot, ThatPrintsNoSvgHasFailed) {
  GnuplotOptions options;
  options.program = "/bin/false";
  EXPECT_EQ(plot_svg({}, options).status, PlotStatus::kGnuplotFailed);
}

TEST(Gnuplot, ThatHangsIsKilled) {
  const dynslam::testing::TempFolder folder;
  const std::string program = folder.file("hang");
  testing::write(program, "#!/bin/sh\nexec sleep 60\n");
  std::filesystem::permissions(program, std::filesystem::perms::owner_all);
  GnuplotOptions options;
  options.program = program;
  options.timeout = 0.2;
  const auto start = std::chrono::steady_clock::now();
  const PlotResult result = plot_svg({}, options);
  EXPECT_EQ(result.status, PlotStatus::kGnuplotFailed);
  EXPECT_NE(result.problem.find("took longer"), std::string::npos);
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(20));
  EXPECT_EQ(waitpid(-1, nullptr, WNOHANG), -1) << "no child is left";
}

TEST(PlotRules, AreChecked) {
  Plot plot = plot_of(line({0, 1}, {0}));
  EXPECT_THROW(plot_svg(plot), InvalidArgument);
  plot = plot_of(line({0, 1}, {0, 1}));
  plot.series[0].color = "red'; system('x')";
  EXPECT_THROW(plot.validate(), InvalidArgument);
  plot.series[0].color = "";
  plot.series[0].line_width = 0.0;
  EXPECT_THROW(plot.validate(), InvalidArgument);
  plot.series[0].line_width = 1.0;
  EXPECT_NO_THROW(plot.validate());
  plot.series[0].style = PlotStyle::kHeat;
  EXPECT_THROW(plot.validate(), InvalidArgument) << "no values";
  plot.series[0].style = PlotStyle::kSegments;
  EXPECT_THROW(plot.validate(), InvalidArgument) << "no ends";
  plot.series[0].x2 = {0, 1};
  EXPECT_THROW(plot.validate(), InvalidArgument) << "half of the ends";
  plot.series[0].style = PlotStyle::kStacked;
  plot.series.push_back(plot.series[0]);
  plot.series[1].x = {0, 2};
  EXPECT_THROW(plot.validate(), InvalidArgument) << "stacked on another x";
  plot = {};
  plot.width = 10;
  EXPECT_THROW(plot.validate(), InvalidArgument);
  plot = {};
  plot.height = 100000;
  EXPECT_THROW(plot.validate(), InvalidArgument);
  GnuplotOptions options;
  options.program = "";
  EXPECT_THROW(options.validate(), InvalidArgument);
  options = {};
  options.timeout = kNaN;
  EXPECT_THROW(plot_svg({}, options), InvalidArgument);
}

TEST(TrajectoryPlots, LookAlongTheAxisOfLeastExtent) {
  const auto view = [](Eigen::Vector3d extent) {
    const Trajectory t = {{0.0, {}}, {1.0, {Eigen::Matrix3d(Eigen::Matrix3d::Identity()), extent}}};
    const ViewAxes axes = choose_view(t);
    return std::pair(axes.across, axes.up);
  };
  EXPECT_EQ(view({5, 4, 1}), std::pair(0, 1));
  EXPECT_EQ(view({5, 1, 4}), std::pair(0, 2));
  EXPECT_EQ(view({1, 4, -5}), std::pair(1, 2));
  EXPECT_EQ(view({0, 0, 0}), std::pair(0, 1));
  EXPECT_EQ(choose_view({}).up, 1);
}

TEST(TrajectoryPlots, HaveAGapWhereTheTrackWasLost) {
  std::mt19937 random(1);
  const Trajectory truth = testing::random_walk(random, 100);
  Trajectory estimate(truth.begin(), truth.begin() + 40);
  estimate.insert(estimate.end(), truth.begin() + 60, truth.end());
  const AteResult result = ate(truth, estimate);
  const Plot map = error_lines_plot(truth, result, "it");
  ASSERT_EQ(map.series.size(), 3u);
  EXPECT_EQ(map.series[2].x.size(), 81u);
  EXPECT_TRUE(std::isnan(map.series[2].x[40]));
  EXPECT_EQ(map.series[1].x.size(), 80u) << "one error line for each pair";
  const Plot heat = error_heat_plot(truth, result);
  EXPECT_TRUE(std::isnan(heat.series[1].value[40]));
  const Plot time = ate_over_time_plot(truth, {{"it", result}});
  EXPECT_EQ(time.series[0].x.size(), 81u);
  EXPECT_DOUBLE_EQ(time.series[0].x[0], 0.0) << "time begins with the truth";
  EXPECT_EQ(time.x_label, "time (s)");
}

TEST(TrajectoryPlots, CountFramesWhereThereAreNoTimes) {
  Trajectory truth(5);
  for (std::size_t i = 0; i < 5; ++i) truth[i].timestamp = static_cast<double>(i);
  EXPECT_EQ(ate_over_time_plot(truth, {}).x_label, "frame");
  EXPECT_EQ(rpe_over_time_plot(truth, rpe(truth, truth)).x_label, "frame");
}

TEST(TrajectoryPlots, OfNothingAreEmptyAndValid) {
  const AteResult none = ate({}, {});
  for (const Plot& plot :
       {error_lines_plot({}, none, ""), error_heat_plot({}, none), overlay_plot({}, {}),
        ate_over_time_plot({}, {{"a", none}}), rpe_over_time_plot({}, rpe({}, {})),
        kitti_by_length_plot(kitti_metric({}, {}))}) {
    EXPECT_NO_THROW(plot.validate());
    for (const PlotSeries& series : plot.series) EXPECT_TRUE(series.x.empty());
  }
}

}  // namespace
}  // namespace dynslam::evaluation
