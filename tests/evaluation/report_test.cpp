#include "dynslam/evaluation/report.hpp"

#include <cmath>
#include <limits>
#include <regex>
#include <set>
#include <vector>

#include <gtest/gtest.h>

#include "dynslam/core/errors.hpp"

#include "evaluation/support.hpp"
#include "temp_folder.hpp"

namespace dynslam::evaluation {
namespace {

using testing::kNaN;

bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

RunRecord record(const std::string& name, const Trajectory& estimate) {
  RunRecord run;
  run.name = name;
  run.estimate = estimate;
  run.stages = {{"extract", {}, false}, {"segment", {}, true}};
  run.series = {{"dynamic points", {}}};
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    run.frame_times.push_back(estimate[i].timestamp);
    run.states.push_back(i < 2    ? FrameState::kNotStarted
                         : i == 7 ? FrameState::kLost
                         : i == 8 ? FrameState::kRelocalized
                                  : FrameState::kTracked);
    run.frame_ms.push_back(20.0);
    run.stages[0].ms.push_back(8.0);
    run.stages[1].ms.push_back(i % 3 ? kNaN : 50.0);
    run.series[0].values.push_back(static_cast<double>(i));
  }
  return run;
}

ReportData sample(int frames = 40) {
  std::mt19937 random(1);
  ReportData data;
  data.title = "run 1";
  data.sequence = "walking";
  data.truth = testing::random_walk(random, frames);
  data.run = record("p-static", testing::with_noise(data.truth, random, 0.01));
  data.others = {record("baseline", testing::with_noise(data.truth, random, 0.2))};
  return data;
}

// Every element that is opened is closed, in order.
void expect_balanced(const std::string& html) {
  static const std::regex kTag("<(/?)([a-zA-Z][a-zA-Z0-9]*)([^<>]*)>");
  std::vector<std::string> open;
  for (std::sregex_iterator it(html.begin(), html.end(), kTag), end; it != end; ++it) {
    const std::string name = (*it)[2], rest = (*it)[3];
    if (name == "meta" || (!rest.empty() && rest.back() == '/')) continue;
    if ((*it)[1].length() == 0) {
      open.push_back(name);
    } else {
      ASSERT_FALSE(open.empty()) << "</" << name << "> closes nothing";
      ASSERT_EQ(open.back(), name);
      open.pop_back();
    }
  }
  EXPECT_TRUE(open.empty());
}

ReportData without_gnuplot(ReportData data) {
  data.gnuplot.program = "no-such-gnuplot";
  return data;
}

TEST(Report, ShowsTheFiguresThatTheMetricsGive) {
  const ReportData data = without_gnuplot(sample());
  const std::string html = report_html(data);
  const double rmse = ate(data.truth, data.run.estimate).error.rmse;
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", rmse);
  EXPECT_TRUE(contains(html, text)) << text;
  for (const char* part :
       {"run 1", "walking", "p-static", "baseline", "extract", "segment", "beside tracking",
        "37 of 40 (92.5 %)", "% smaller", "50.0 frames a second", "Relative over 1 frame"}) {
    EXPECT_TRUE(contains(html, part)) << part;
  }
  expect_balanced(html);
}

TEST(Report, KeepsItsTablesWithoutGnuplotAndSaysWhy) {
  ReportResult result;
  const std::string html = report_html(without_gnuplot(sample()), &result);
  EXPECT_EQ(result.plots, 0u);
  EXPECT_TRUE(contains(result.problem, "no-such-gnuplot"));
  EXPECT_TRUE(contains(html, "Plots are missing."));
  EXPECT_TRUE(contains(html, "<h2>Errors</h2>"));
  EXPECT_TRUE(contains(html, "<h2>Comparison</h2>"));
  EXPECT_TRUE(contains(html, "<h2>Time</h2>"));
  EXPECT_FALSE(contains(html, "<figure"));
}

TEST(Report, AsksForNothingFromOutside) {
  ReportResult result;
  const std::string html = report_html(sample(), &result);
  if (result.plots == 0) GTEST_SKIP() << "gnuplot is not installed";
  EXPECT_EQ(result.plots, 7u);
  EXPECT_TRUE(result.problem.empty());
  for (const char* part :
       {"http:", "https:", "src=", "url(", "@import", "<link", "<script", "href=\"h"}) {
    EXPECT_FALSE(contains(html, part)) << part;
  }
  expect_balanced(html);
  // Ids are unique in a page.
  static const std::regex kId("\\bid=[\"']([^\"']+)[\"']");
  std::set<std::string> ids;
  for (std::sregex_iterator it(html.begin(), html.end(), kId), end; it != end; ++it) {
    EXPECT_TRUE(ids.insert((*it)[1]).second) << (*it)[1];
  }
}

TEST(Report, EscapesEveryNameItIsGiven) {
  const std::string evil = "<b id=x>&\"'</b>\x01\xff";
  ReportData data = sample(10);
  data.title = data.subtitle = data.sequence = evil;
  data.run.name = data.others[0].name = evil;
  data.run.stages[0].name = data.run.stages[1].name = data.run.series[0].name = evil;
  data.run.facts = {{evil, evil}};
  for (const ReportData& given : {data, without_gnuplot(data)}) {
    const std::string html = report_html(given);
    EXPECT_FALSE(contains(html, "<b id=x>"));
    EXPECT_FALSE(contains(html, "\x01"));
    EXPECT_FALSE(contains(html, "\xff"));
    EXPECT_TRUE(contains(html, "&lt;b id=x&gt;&amp;&quot;&#39;&lt;/b&gt;??"));
    expect_balanced(html);
  }
  data.gnuplot.program = evil;
  EXPECT_FALSE(contains(report_html(data), "<b id=x>"));
}

TEST(Report, OfARunWithoutTruthHasNoErrors) {
  ReportData data = without_gnuplot(sample());
  data.truth.clear();
  const std::string html = report_html(data);
  EXPECT_TRUE(contains(html, "No true trajectory was given"));
  EXPECT_FALSE(contains(html, "<h2>Errors</h2>"));
  EXPECT_TRUE(contains(html, "<h2>Time</h2>"));
}

TEST(Report, OfARunWithoutPosesSaysSo) {
  ReportData data = without_gnuplot(sample());
  data.run.estimate.clear();
  EXPECT_TRUE(contains(report_html(data), "The system wrote no poses."));
}

TEST(Report, OfTrajectoriesOnDifferentClocksSaysSo) {
  ReportData data = without_gnuplot(sample());
  for (StampedPose& pose : data.run.estimate) pose.timestamp += 1e6;
  EXPECT_TRUE(contains(report_html(data), "Do both trajectories use the same clock?"));
}

TEST(Report, OfNothingAtAllIsStillAPage) {
  for (const int frames : {0, 1, 2}) {
    ReportData data = sample(frames);
    expect_balanced(report_html(data));
    data.truth.clear();
    data.others.clear();
    expect_balanced(report_html(data));
  }
  expect_balanced(report_html({}));
}

TEST(Report, IsWrittenCompleteOrNotAtAll) {
  const dynslam::testing::TempFolder folder;
  const ReportData data = without_gnuplot(sample(10));
  EXPECT_FALSE(write_report(folder.file("report.html"), data).problem.empty());
  EXPECT_EQ(testing::read(folder.file("report.html")), report_html(data));
  EXPECT_EQ(folder.entries(), 1u);
  EXPECT_THROW(write_report(folder.file("no/report.html"), data), IoError);
}

TEST(Report, ChecksItsData) {
  const auto refused = [](auto&& spoil) {
    ReportData data = sample(10);
    spoil(data);
    EXPECT_THROW(report_html(data), InvalidArgument);
  };
  refused([](ReportData& d) { d.run.states.pop_back(); });
  refused([](ReportData& d) { d.run.frame_ms.push_back(1.0); });
  refused([](ReportData& d) { d.run.stages[0].ms.pop_back(); });
  refused([](ReportData& d) { d.run.series[0].values.clear(); });
  refused([](ReportData& d) { d.others[0].states.pop_back(); });
  refused([](ReportData& d) { d.run.frame_times[3] = d.run.frame_times[2]; });
  refused([](ReportData& d) { d.run.frame_times[3] = kNaN; });
  refused([](ReportData& d) { d.rpe.delta = 0.0; });
  refused([](ReportData& d) { d.ate.association.max_difference = -1.0; });
  refused([](ReportData& d) { d.gnuplot.timeout = 0.0; });
  refused([](ReportData& d) { d.truth[3].timestamp = 0.0; });
}

}  // namespace
}  // namespace dynslam::evaluation
