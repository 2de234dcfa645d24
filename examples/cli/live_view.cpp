#include "live_view.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <utility>

#include <opencv2/highgui.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "dynslam/core/errors.hpp"

namespace dynslam::cli {
namespace {

namespace fs = std::filesystem;

constexpr const char* kWindow = "dynslam";
constexpr int kBarHeight = 26;  // pixels, of the text above the image

// BGR, told apart by the colour-blind as well.
const cv::Scalar kStaticColor(115, 158, 0);
const cv::Scalar kRejectedColor(0, 159, 230);
const cv::Scalar kMovingColor(60, 60, 235);
const cv::Scalar kUnmatchedColor(190, 190, 190);
const cv::Scalar kMaskColor(178, 114, 0);
const cv::Scalar kInk(255, 255, 255);

void write(cv::Mat& image, const std::string& text, cv::Point at, const cv::Scalar& color) {
  cv::putText(image, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, cv::Scalar::all(0), 3, cv::LINE_AA);
  cv::putText(image, text, at, cv::FONT_HERSHEY_SIMPLEX, 0.45, color, 1, cv::LINE_AA);
}

void tint(cv::Mat& image, const cv::Mat& mask) {
  if (mask.empty()) return;
  cv::Mat colored(image.size(), image.type(), kMaskColor);
  cv::addWeighted(image, 0.6, colored, 0.4, 0.0, colored);
  colored.copyTo(image, mask);
}

void draw_legend(cv::Mat& image) {
  const std::pair<const char*, cv::Scalar> entries[] = {{"static", kStaticColor},
                                                        {"rejected", kRejectedColor},
                                                        {"moving", kMovingColor},
                                                        {"unmatched", kUnmatchedColor},
                                                        {"mask", kMaskColor}};
  int x = 8;
  for (const auto& [name, color] : entries) {
    cv::circle(image, {x + 4, image.rows - 12}, 4, color, cv::FILLED, cv::LINE_AA);
    write(image, name, {x + 12, image.rows - 8}, kInk);
    x += 22 + 8 * static_cast<int>(std::string(name).size());
  }
}

// The way from above, in a corner; all of it fits, metres to the right and forward.
void draw_way(cv::Mat& image, const std::vector<cv::Point2d>& way) {
  const int side = std::min(image.cols, image.rows) / 4;
  cv::Mat inset = image(cv::Rect(image.cols - side - 6, image.rows - side - 6, side, side));
  inset = inset * 0.35;
  if (way.empty()) return;
  const auto by_x = std::minmax_element(way.begin(), way.end(),
                                        [](const auto& a, const auto& b) { return a.x < b.x; });
  const auto by_z = std::minmax_element(way.begin(), way.end(),
                                        [](const auto& a, const auto& b) { return a.y < b.y; });
  const cv::Point2d middle(0.5 * (by_x.first->x + by_x.second->x),
                           0.5 * (by_z.first->y + by_z.second->y));
  const double extent = std::max({by_x.second->x - by_x.first->x,  //
                                  by_z.second->y - by_z.first->y, 0.5});
  const double scale = 0.85 * side / extent;
  std::vector<cv::Point> line;
  for (const cv::Point2d& at : way) {
    line.emplace_back(cvRound(0.5 * side + scale * (at.x - middle.x)),
                      cvRound(0.5 * side - scale * (at.y - middle.y)));
  }
  cv::polylines(inset, line, false, kStaticColor, 1, cv::LINE_AA);
  cv::circle(inset, line.back(), 3, kInk, cv::FILLED, cv::LINE_AA);
  char text[32];
  std::snprintf(text, sizeof text, "%.1f m", extent);
  write(inset, text, {4, 14}, kInk);
}

std::string status(const std::string& system, const FrameRow& row) {
  char text[160];
  const int length =
      std::snprintf(text, sizeof text, "%s  frame %u  %s  %d inliers  %.1f ms", system.c_str(),
                    row.index, to_string(row.state), row.inliers, row.ms.total);
  std::string line(text, static_cast<std::size_t>(std::min<int>(length, sizeof text - 1)));
  if (row.mask_age == 0) line += "  mask fresh";
  if (row.mask_age > 0) line += "  mask " + std::to_string(row.mask_age) + " frames old";
  if (row.keyframe) line += "  keyframe";
  return line;
}

bool is_set(const char* variable) {
  const char* value = std::getenv(variable);
  return value != nullptr && *value != '\0';
}

}  // namespace

void draw_features(cv::Mat& image, const slam::FeaturesView& view) {
  for (std::size_t i = 0; i < view.verdicts.size(); ++i) {
    const cv::Point at(view.features->keypoints[i].pt);
    switch (view.verdicts[i]) {
      case slam::FeatureVerdict::kUnmatched:
        cv::circle(image, at, 1, kUnmatchedColor, cv::FILLED);
        break;
      case slam::FeatureVerdict::kStatic:
        cv::circle(image, at, 3, kStaticColor, 1, cv::LINE_AA);
        break;
      case slam::FeatureVerdict::kRejected:
        cv::circle(image, at, 3, kRejectedColor, 1, cv::LINE_AA);
        break;
      case slam::FeatureVerdict::kMoving:
        cv::drawMarker(image, at, kMovingColor, cv::MARKER_TILTED_CROSS, 7, 1, cv::LINE_AA);
        break;
    }
  }
}

class LiveView::Film {
 public:
  Film(const std::string& path, double fps, cv::Size size) : path_(path) {
    const std::string ending = fs::path(path).extension().string();
    const bool mp4 = ending == ".mp4";
    if (!mp4 && ending != ".avi") throw_io_error(path, "a film is an .mp4 or an .avi file");
    const fs::path folder = fs::path(path).parent_path();
    if (!folder.empty() && !fs::is_directory(folder))
      throw_io_error(path, "there is no such folder");
    for (const char* code : {mp4 ? "mp4v" : "MJPG", mp4 ? "avc1" : "XVID"}) {
      const int fourcc = cv::VideoWriter::fourcc(code[0], code[1], code[2], code[3]);
      if (writer_.open(path, fourcc, fps, size)) return;
    }
    throw_io_error(path,
                   mp4 ? "cannot be written; this OpenCV may have no encoder for .mp4: try .avi"
                       : "cannot be written");
  }
  void add(const cv::Mat& image) { writer_.write(image); }
  void finish() {
    writer_.release();
    std::error_code error;
    if (fs::file_size(path_, error) == 0 || error) throw_io_error(path_, "nothing was written");
  }

 private:
  std::string path_;
  cv::VideoWriter writer_;
};

class LiveView::Window {
 public:
  Window() {
    if (!is_set("DISPLAY") && !is_set("WAYLAND_DISPLAY")) {
      throw_io_error("--show", "there is no display; use --video FILE.mp4");
    }
    try {
      cv::namedWindow(kWindow, cv::WINDOW_AUTOSIZE);
    } catch (const cv::Exception& error) {
      throw_io_error("--show", "no window can be opened: " + error.err);
    }
  }
  ~Window() {
    try {
      cv::destroyWindow(kWindow);
    } catch (const cv::Exception&) {  // closed by hand
    }
  }
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;
  void add(const cv::Mat& image) {
    cv::imshow(kWindow, image);
    cv::waitKey(1);
  }
};

LiveView::LiveView(const RunFlags& flags, const dataset::Sequence& sequence) : name_(flags.system) {
  const DepthCamera camera = sequence.camera();
  const cv::Size size(camera.width, camera.height + kBarHeight);
  if (!flags.video.empty()) film_ = std::make_unique<Film>(flags.video, sequence.fps(), size);
  if (flags.show) window_ = std::make_unique<Window>();
}

LiveView::~LiveView() = default;

void LiveView::add(const dataset::Frame& frame, const cv::Mat& mask, const FrameRow& row,
                   const slam::FrameResult& result, const slam::System& system) {
  if (!active()) return;
  if (result.T_world_cam) {
    const Eigen::Vector3d& centre = result.T_world_cam->t;
    way_.emplace_back(centre.x(), centre.z());
  }
  cv::Mat canvas(frame.color.rows + kBarHeight, frame.color.cols, CV_8UC3, cv::Scalar::all(30));
  cv::Mat image = canvas(cv::Rect(0, kBarHeight, frame.color.cols, frame.color.rows));
  if (frame.color.channels() == 1) {
    cv::cvtColor(frame.color, image, cv::COLOR_GRAY2BGR);
  } else {
    frame.color.copyTo(image);
  }
  tint(image, mask);
  draw_features(image, system.features());
  draw_way(image, way_);
  draw_legend(image);
  write(canvas, status(name_, row), {8, kBarHeight - 8}, kInk);
  if (film_) film_->add(canvas);
  if (window_) window_->add(canvas);
}

void LiveView::finish() {
  if (film_) film_->finish();
  film_.reset();
  window_.reset();
}

}  // namespace dynslam::cli
