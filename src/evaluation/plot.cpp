#include "dynslam/evaluation/plot.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

#include "evaluation/gnuplot.hpp"
#include "evaluation/text.hpp"

namespace dynslam::evaluation {
namespace {

constexpr std::size_t kMaxPoints = 4000;
constexpr int kColorBoxRoom = 100;  // pixels right of the frame
constexpr double kLargestNumber = 1e100;

bool drawable(double value) { return std::abs(value) < kLargestNumber; }  // false for NaN

std::string quoted(const std::string& text) {
  std::string quoted = "'";
  for (const char c : clean_text(text)) {
    quoted += c;
    if (c == '\'') quoted += c;  // doubled, it is a quote mark; nothing else is special in '...'
  }
  return quoted + "'";
}

void append(std::string& script, double value) {
  char buffer[64];
  script.append(buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr);
}

bool is_color(const std::string& text) {
  return text.size() == 7 && text[0] == '#' &&
         text.find_first_not_of("0123456789abcdefABCDEF", 1) == std::string::npos;
}

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();

  void add(double value) {
    if (!drawable(value)) return;
    low = std::min(low, value);
    high = std::max(high, value);
  }
  double size() const { return high - low; }
  void widen(double share) {
    const double margin = share * size();
    low -= margin;
    high += margin;
  }
  // A range that gnuplot can draw: of some width, whatever the data was.
  void make_usable() {
    if (low > high) *this = {0.0, 1.0};
    const double least = std::max(1e-9, 1e-9 * std::max(std::abs(low), std::abs(high)));
    if (size() < least) {
      const double half = std::max(0.5 * std::abs(low), 0.5) * 0.1;
      low -= half;
      high += half;
    }
  }
};

// Indices of a series that are drawn: all, or of each of many buckets the first, the last, the
// lowest, the highest and where gaps begin.
std::vector<std::size_t> drawn_points(const PlotSeries& series) {
  const std::size_t n = series.x.size();
  std::vector<std::size_t> kept;
  if (n <= kMaxPoints) {
    kept.resize(n);
    std::iota(kept.begin(), kept.end(), std::size_t{0});
    return kept;
  }
  const auto gap = [&](std::size_t i) { return !drawable(series.x[i]) || !drawable(series.y[i]); };
  const std::vector<double>& key = series.style == PlotStyle::kHeat ? series.value : series.y;
  std::vector<std::size_t> pick;
  const std::size_t buckets = kMaxPoints / 4;
  for (std::size_t b = 0; b < buckets; ++b) {
    const std::size_t begin = n * b / buckets, end = n * (b + 1) / buckets;
    pick = {begin, end - 1, begin, begin};
    for (std::size_t i = begin; i < end; ++i) {
      if (key[i] < key[pick[2]] || !drawable(key[pick[2]])) pick[2] = i;
      if (key[i] > key[pick[3]] || !drawable(key[pick[3]])) pick[3] = i;
    }
    for (std::size_t i = begin; i < end; ++i) {
      if (gap(i) && (i == 0 || !gap(i - 1))) pick.push_back(i);
    }
    std::sort(pick.begin(), pick.end());
    kept.insert(kept.end(), pick.begin(), std::unique(pick.begin(), pick.end()));
  }
  return kept;
}

// The columns of a stacked series: x, its floor and its top, thinned to the mean of each bucket.
struct Stack {
  std::vector<double> x, floor, top;

  explicit Stack(const PlotSeries& series, std::vector<double>& height) {
    const std::size_t n = series.x.size();
    const std::size_t buckets = std::min<std::size_t>(n, kMaxPoints / 4);
    height.resize(std::max(height.size(), buckets), 0.0);
    for (std::size_t b = 0; b < buckets; ++b) {
      const std::size_t begin = n * b / buckets, end = n * (b + 1) / buckets;
      double sum = 0.0;
      for (std::size_t i = begin; i < end; ++i) sum += drawable(series.y[i]) ? series.y[i] : 0.0;
      x.push_back(series.x[begin]);
      floor.push_back(height[b]);
      height[b] += sum / static_cast<double>(end - begin);
      top.push_back(height[b]);
    }
  }
};

// Builds the script of one plot.
class Script {
 public:
  explicit Script(const Plot& plot) : plot_(plot) {
    std::vector<double> height;
    for (std::size_t i = 0; i < plot.series.size(); ++i) add_series(plot.series[i], i, height);
  }

  std::string text() {
    std::string script = header();
    script += data_;
    script += curves_.empty() ? "plot NaN notitle\n" : "plot " + curves_ + "\n";
    return script;
  }

 private:
  void row(std::initializer_list<double> values) {
    for (const double v : values) {
      append(data_, v);
      data_ += ' ';
    }
    data_ += '\n';
  }

  void add_series(const PlotSeries& series, std::size_t index, std::vector<double>& height) {
    const std::string block = "$d" + std::to_string(index);
    const std::size_t begin = data_.size();
    data_ += block + " << END_OF_DATA\n";
    const bool any =
        series.style == PlotStyle::kStacked ? add_stack(series, height) : add_points(series);
    data_ += "END_OF_DATA\n";
    if (!any) {  // gnuplot stops at a series without a point
      data_.resize(begin);
      return;
    }
    const std::string color = series.color.empty() ? series_color(index) : series.color;
    if (!curves_.empty()) curves_ += ", ";
    curves_ += block + curve_style(series, color) +
               (series.name.empty() ? " notitle" : " title " + quoted(series.name));
  }

  bool add_points(const PlotSeries& series) {
    bool any = false;
    for (const std::size_t i : drawn_points(series)) {
      const bool segment = series.style == PlotStyle::kSegments;
      const bool heat = series.style == PlotStyle::kHeat;
      if (!drawable(series.x[i]) || !drawable(series.y[i]) ||
          (segment && (!drawable(series.x2[i]) || !drawable(series.y2[i]))) ||
          (heat && !drawable(series.value[i]))) {
        data_ += '\n';
        continue;
      }
      any = true;
      x_.add(series.x[i]);
      y_.add(series.y[i]);
      if (segment) {
        x_.add(series.x2[i]);
        y_.add(series.y2[i]);
        row({series.x[i], series.y[i], series.x2[i] - series.x[i], series.y2[i] - series.y[i]});
      } else if (heat) {
        value_.add(series.value[i]);
        row({series.x[i], series.y[i], series.value[i]});
      } else {
        row({series.x[i], series.y[i]});
      }
    }
    return any;
  }

  bool add_stack(const PlotSeries& series, std::vector<double>& height) {
    const Stack stack(series, height);
    bool any = false;
    for (std::size_t i = 0; i < stack.x.size(); ++i) {
      if (!drawable(stack.x[i]) || !drawable(stack.top[i])) continue;
      any = true;
      x_.add(stack.x[i]);
      y_.add(0.0);
      y_.add(stack.top[i]);
      row({stack.x[i], stack.floor[i], stack.top[i]});
    }
    return any;
  }

  static std::string curve_style(const PlotSeries& series, const std::string& color) {
    const std::string rgb = " lc rgb '" + color + "'";
    const std::string width = number(series.line_width, 2);
    switch (series.style) {
      case PlotStyle::kLine:
        return " with lines lw " + width + rgb;
      case PlotStyle::kDashed:
        return " with lines dt (7,5) lw " + width + rgb;
      case PlotStyle::kPoints:
        return " with points pt 7 ps " + number(series.line_width / 10.0, 3) + rgb;
      case PlotStyle::kSegments:
        return " using 1:2:3:4 with vectors nohead lw " + width + rgb;
      case PlotStyle::kHeat:
        return " using 1:2:3 with lines lw " + width + " lc palette";
      case PlotStyle::kStacked:
        return " using 1:2:3 with filledcurves fs solid 0.85 noborder" + rgb;
    }
    return {};
  }

  void fit_equal_axes() {
    // Both ranges grow to fill the canvas, so that the frame is not a narrow strip.
    const double across =
        std::max(plot_.width - 80.0 - (value_.low <= value_.high ? kColorBoxRoom : 20), 50.0);
    const double up = std::max(plot_.height - 100.0, 50.0);
    const double unit = std::max(x_.size() / across, y_.size() / up);
    x_.widen(0.5 * (unit * across / x_.size() - 1.0));
    y_.widen(0.5 * (unit * up / y_.size() - 1.0));
  }

  static std::string range_text(const char* axis, const Range& range) {
    std::string text = std::string("set ") + axis + "range [";
    append(text, range.low);
    text += ':';
    append(text, range.high);
    return text + "]\n";
  }

  // Beside the frame, in the room that is kept free for it.
  std::string color_box() const {
    const auto screen = [&](int pixels_from_right) {
      return number(1.0 - static_cast<double>(pixels_from_right) / plot_.width, 4);
    };
    return "set cblabel " + quoted(plot_.value_label) +
           " textcolor rgb '#4a5560'\nset rmargin at screen " + screen(kColorBoxRoom) +
           "\nset colorbox user origin screen " + screen(kColorBoxRoom - 18) +
           ", graph 0.05 size screen " + number(14.0 / plot_.width, 4) +
           ", graph 0.9 noborder\nset cbtics scale 0\n"
           "set palette defined (0 '#2c3e94', 0.25 '#2a86b5', 0.5 '#41b58a', 0.75 '#f2c14b', "
           "1 '#d1352b')\n";
  }

  std::string header() {
    x_.make_usable();
    y_.make_usable();
    if (plot_.y_from_zero) y_.low = std::min(y_.low, 0.0);
    if (plot_.equal_axes) {
      x_.widen(0.04);
      y_.widen(0.04);
      fit_equal_axes();
    } else {
      y_.high += 0.06 * y_.size();
      if (!plot_.y_from_zero) y_.low -= 0.06 * y_.size();
    }
    std::string s = "set encoding utf8\nset terminal svg noenhanced rounded size " +
                    std::to_string(plot_.width) + "," + std::to_string(plot_.height) +
                    " font 'sans-serif,12' background rgb 'white' dashlength 1\n"
                    "set border 3 lc rgb '#9aa3ad' lw 1\n"
                    "set tics nomirror scale 0.5 textcolor rgb '#4a5560'\n"
                    "set grid lc rgb '#e6e9ed' lt 1 lw 1\n"
                    "set key outside top left horizontal Left reverse samplen 2 "
                    "textcolor rgb '#2b333b'\n";
    if (!plot_.title.empty())
      s += "set title " + quoted(plot_.title) + " textcolor rgb '#1d242b'\n";
    s += "set xlabel " + quoted(plot_.x_label) + " textcolor rgb '#4a5560'\n";
    s += "set ylabel " + quoted(plot_.y_label) + " textcolor rgb '#4a5560'\n";
    s += range_text("x", x_) + range_text("y", y_);
    if (plot_.equal_axes) s += "set size ratio -1\n";
    if (value_.low <= value_.high) {
      value_.make_usable();
      s += range_text("cb", value_) + color_box();
    }
    return s;
  }

  const Plot& plot_;
  Range x_, y_, value_;
  std::string data_, curves_;
};

}  // namespace

const char* series_color(std::size_t index) {
  constexpr std::array<const char*, 7> palette = {"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                                  "#e69f00", "#56b4e9", "#6b6b6b"};
  return palette[index % palette.size()];
}

void Plot::validate() const {
  require(width >= 100 && width <= 10000, "Plot", "width", width, "100..10000 pixels");
  require(height >= 100 && height <= 10000, "Plot", "height", height, "100..10000 pixels");
  const PlotSeries* stack = nullptr;
  for (std::size_t i = 0; i < series.size(); ++i) {
    const PlotSeries& s = series[i];
    const std::string name = "series[" + std::to_string(i) + "]";
    const std::string same = "as many as x has, " + std::to_string(s.x.size());
    require(s.y.size() == s.x.size(), "Plot", name + ".y", s.y.size(), same);
    require(s.line_width > 0.0 && s.line_width < 1000.0, "Plot", name + ".line_width", s.line_width,
            "a width above 0");
    require(s.color.empty() || is_color(s.color), "Plot", name + ".color", s.color, "#rrggbb");
    if (s.style == PlotStyle::kSegments) {
      require(s.x2.size() == s.x.size(), "Plot", name + ".x2", s.x2.size(), same);
      require(s.y2.size() == s.x.size(), "Plot", name + ".y2", s.y2.size(), same);
    }
    if (s.style == PlotStyle::kHeat) {
      require(s.value.size() == s.x.size(), "Plot", name + ".value", s.value.size(), same);
    }
    if (s.style == PlotStyle::kStacked) {
      require(stack == nullptr || stack->x == s.x, "Plot", name + ".x", "other values",
              "the x of the stacked series before it");
      stack = &s;
    }
  }
}

void GnuplotOptions::validate() const {
  require(!program.empty() && program.find('\0') == std::string::npos, "GnuplotOptions", "program",
          program, "a path or name");
  require(timeout > 0.0 && std::isfinite(timeout), "GnuplotOptions", "timeout", timeout,
          "a finite time above 0 s");
}

PlotResult plot_svg(const Plot& plot, const GnuplotOptions& options) {
  plot.validate();
  options.validate();
  return run_gnuplot(Script(plot).text(), options);
}

void write_plot(const std::string& path, const Plot& plot, const GnuplotOptions& options) {
  const PlotResult result = plot_svg(plot, options);
  if (result.status != PlotStatus::kOk) {
    throw_io_error(path, "the plot could not be drawn: " + result.problem);
  }
  write_file_atomically(path, "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n" + result.svg + "\n");
}

}  // namespace dynslam::evaluation
