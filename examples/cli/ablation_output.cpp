#include "ablation_output.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>

#include "dynslam/core/version.hpp"

#include "run_output.hpp"

namespace dynslam::cli {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kStyle =
    "body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;"
    "color:#222}table{border-collapse:collapse;width:100%}th,td{padding:.25rem .6rem;"
    "text-align:right;border-bottom:1px solid #ddd;white-space:nowrap}th:first-child,"
    "td:first-child{text-align:left}tr.whole td{border-top:2px solid #888;font-weight:600}"
    "td.bar{width:30%;text-align:left}td.bar div{height:.8rem;border-radius:2px}"
    ".ate{background:#0072b2}.ms{background:#e69f00}";

std::string number_or_dash(const char* pattern, double value) {
  if (std::isnan(value)) return "-";
  char text[64];
  std::snprintf(text, sizeof text, pattern, value);
  return text;
}

std::string escape(const std::string& text) {
  std::string safe;
  for (const char c : text) {
    switch (c) {
      case '&':
        safe += "&amp;";
        break;
      case '<':
        safe += "&lt;";
        break;
      case '"':
        safe += "&quot;";
        break;
      default:
        safe += c;
    }
  }
  return safe;
}

std::string row_name(const Cell& cell) {
  return cell.without.empty() ? cell.system : "  without " + cell.without;
}

// The cells of one sequence stand together, in the order in which they were run.
std::vector<std::vector<Cell>> by_sequence(const std::vector<Cell>& cells) {
  std::vector<std::vector<Cell>> groups;
  for (const Cell& cell : cells) {
    if (groups.empty() || groups.back().front().sequence != cell.sequence) groups.emplace_back();
    groups.back().push_back(cell);
  }
  return groups;
}

std::string csv(const std::vector<Cell>& cells) {
  std::ostringstream out;
  out << "sequence,system,without,runs,tracked_share,ate_median,ate_iqr,ms_median,ms_p95\n";
  for (const Cell& cell : cells) {
    const CellSummary summary = summarize(cell);
    out << cell.sequence << ',' << cell.system << ',' << cell.without << ',' << cell.runs.size();
    for (const double value : {summary.tracked_share, summary.ate_median, summary.ate_iqr,
                               summary.ms_median, summary.ms_p95}) {
      out << ',' << (std::isnan(value) ? "" : number_or_dash("%.6g", value));
    }
    out << '\n';
  }
  return out.str();
}

// A bar as long as the value's share of the largest.
std::string bar(const char* kind, double value, double largest) {
  if (!(value > 0.0) || !(largest > 0.0)) return "<td class=bar></td>";
  return std::string("<td class=bar><div class=") + kind +
         " style=\"width:" + number_or_dash("%.1f", std::max(0.5, 100.0 * value / largest)) +
         "%\"></div></td>";
}

void write_section(std::ostringstream& out, const std::vector<Cell>& cells) {
  double largest_ate = 0.0, largest_ms = 0.0;
  for (const Cell& cell : cells) {
    const CellSummary summary = summarize(cell);
    if (summary.ate_median > largest_ate) largest_ate = summary.ate_median;
    if (summary.ms_median > largest_ms) largest_ms = summary.ms_median;
  }
  out << "<h2>" << escape(cells.front().sequence) << "</h2>\n<table><tr><th>system<th>tracked"
      << "<th>ATE, m<th>IQR<th><th>ms a frame<th>p95<th></tr>\n";
  for (const Cell& cell : cells) {
    const CellSummary summary = summarize(cell);
    out << (cell.without.empty() ? "<tr class=whole><td>" : "<tr><td>&emsp;")
        << escape(row_name(cell)) << "</td><td>"
        << number_or_dash("%.1f %%", 100.0 * summary.tracked_share) << "</td><td>"
        << number_or_dash("%.4f", summary.ate_median) << "</td><td>"
        << number_or_dash("%.4f", summary.ate_iqr) << "</td>"
        << bar("ate", summary.ate_median, largest_ate) << "<td>"
        << number_or_dash("%.1f", summary.ms_median) << "</td><td>"
        << number_or_dash("%.1f", summary.ms_p95) << "</td>"
        << bar("ms", summary.ms_median, largest_ms) << "</tr>\n";
  }
  out << "</table>\n";
}

std::string html(const AblationPlan& plan, const std::vector<Cell>& cells) {
  std::ostringstream out;
  out << "<!doctype html><html lang=en><meta charset=utf-8><title>dynslam ablation</title><style>"
      << kStyle << "</style>\n<h1>Which parts earn their keep</h1>\n<p>dynslam " << kVersion
      << ", segmenter " << escape(plan.run.segmenter) << ", " << plan.run.features
      << " features, medians of " << plan.runs
      << " runs. ATE is the root mean square after rigid alignment, over the frames tracked; bars "
         "compare within a sequence.</p>\n";
  for (const std::vector<Cell>& group : by_sequence(cells)) write_section(out, group);
  out << "</html>\n";
  return out.str();
}

}  // namespace

Json ablation_json(const AblationPlan& plan, const std::vector<Cell>& cells) {
  Json json = {{"version", kVersion},
               {"segmenter", plan.run.segmenter},
               {"features", plan.run.features},
               {"runs", plan.runs},
               {"cells", Json::array()}};
  for (const Cell& cell : cells) {
    const CellSummary summary = summarize(cell);
    Json entry = {{"sequence", cell.sequence},
                  {"system", cell.system},
                  {"without", cell.without.empty() ? Json(nullptr) : Json(cell.without)},
                  {"tracked_share", number(summary.tracked_share)},
                  {"ate_median", number(summary.ate_median)},
                  {"ate_iqr", number(summary.ate_iqr)},
                  {"ms_median", number(summary.ms_median)},
                  {"ms_p95", number(summary.ms_p95)},
                  {"runs", Json::array()}};
    for (const CellRun& run : cell.runs) entry["runs"].push_back(to_json(run));
    json["cells"].push_back(std::move(entry));
  }
  return json;
}

std::string ablation_table(const std::vector<Cell>& cells) {
  std::ostringstream out;
  char line[160];
  for (const std::vector<Cell>& group : by_sequence(cells)) {
    out << group.front().sequence << ", medians of " << group.front().runs.size() << " runs\n";
    std::snprintf(line, sizeof line, "  %-22s %8s %12s %9s %11s %8s\n", "system", "tracked",
                  "ATE RMSE, m", "IQR", "ms a frame", "p95");
    out << line;
    for (const Cell& cell : group) {
      const CellSummary summary = summarize(cell);
      std::snprintf(line, sizeof line, "  %-22s %7.1f%% %12s %9s %11s %8s\n",
                    row_name(cell).c_str(), 100.0 * summary.tracked_share,
                    number_or_dash("%.4f", summary.ate_median).c_str(),
                    number_or_dash("%.4f", summary.ate_iqr).c_str(),
                    number_or_dash("%.1f", summary.ms_median).c_str(),
                    number_or_dash("%.1f", summary.ms_p95).c_str());
      out << line;
    }
  }
  return out.str();
}

void write_ablation(const std::filesystem::path& folder, const AblationPlan& plan,
                    const std::vector<Cell>& cells) {
  write_text(folder / "ablation.json", ablation_json(plan, cells).dump(2) + "\n");
  write_text(folder / "ablation.csv", csv(cells));
  write_text(folder / "ablation.html", html(plan, cells));
}

}  // namespace dynslam::cli
