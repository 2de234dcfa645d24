#include "dynslam/dataset/tum_writer.hpp"

#include <charconv>
#include <cmath>
#include <string>
#include <system_error>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

#include "dataset/files.hpp"

namespace dynslam::dataset {
namespace {

namespace fs = std::filesystem;

constexpr const char* kIndexFiles[] = {"associations.txt", "rgb.txt", "depth.txt", "camera.txt",
                                       "groundtruth.txt"};
constexpr double kLargestTime = 1e12;  // 31,000 years; six digits after the point still differ

// printf would write a comma in some locales.
std::string fixed(double value, int digits) {
  char buffer[400];
  const auto end =
      std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::fixed, digits).ptr;
  return {buffer, end};
}

std::string shortest(double value) {
  char buffer[40];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

void expect_image(const cv::Mat& image, const DepthCamera& camera, bool right_type,
                  const char* parameter, const char* type) {
  const std::string expected = std::string(type) + " of " + std::to_string(camera.width) + " x " +
                               std::to_string(camera.height);
  if (image.dims != 2 || !right_type || image.cols != camera.width || image.rows != camera.height) {
    throw_invalid_argument("TumWriter::add", parameter,
                           image.empty() ? std::string("an empty image")
                                         : cv::typeToString(image.type()) + " of " +
                                               std::to_string(image.cols) + " x " +
                                               std::to_string(image.rows),
                           expected);
  }
}

cv::Mat to_units(const cv::Mat& depth, double scale) {
  constexpr double kMost = 65535.0;
  cv::Mat units(depth.size(), CV_16UC1);
  for (int y = 0; y < depth.rows; ++y) {
    const float* from = depth.ptr<float>(y);
    std::uint16_t* to = units.ptr<std::uint16_t>(y);
    for (int x = 0; x < depth.cols; ++x) {
      const double u = std::floor(static_cast<double>(from[x]) * scale + 0.5);
      to[x] = u > 0.0 && u <= kMost ? static_cast<std::uint16_t>(u) : std::uint16_t{0};
    }
  }
  return units;
}

}  // namespace

class TumWriter::Impl {
 public:
  Impl(const fs::path& folder, const DepthCamera& camera, const TumWriterOptions& options)
      : folder_(folder), camera_(camera), options_(options) {
    options.validate();
    camera.validate();
    for (const char* file : kIndexFiles) {
      std::error_code error;
      if (!options.overwrite && fs::exists(folder_ / file, error)) {
        throw_io_error((folder_ / file).string(),
                       "the folder holds a sequence already, expected an empty one or overwrite");
      }
    }
    detail::make_folder(folder_ / "rgb");
    for (const char* file : kIndexFiles) remove(file);
  }

  void add(const Frame& frame) {
    check(frame);
    const std::string time = fixed(frame.timestamp, 6);
    const std::string file = time + ".png";
    write_image("rgb", file, frame.color);
    if (!frame.depth.empty())
      write_image("depth", file, to_units(frame.depth, options_.depth_scale));
    if (!frame.mask.empty()) {
      write_image("mask", file, frame.mask);
    } else {
      remove(fs::path("mask") / file);  // one that an earlier sequence left
    }
    times_.push_back(time);
    last_ = frame.timestamp;
    has_depth_ = !frame.depth.empty();
    if (frame.T_world_cam) add_pose(time, *frame.T_world_cam);
  }

  void finish() {
    require(!finished_, "TumWriter", "finish", "a second call", "one call");
    require(!times_.empty(), "TumWriter", "finish", "no frames", "at least one frame");
    // The files by which a reader knows a sequence come last.
    if (!truth_.empty()) {
      write_text("groundtruth.txt", "# timestamp tx ty tz qx qy qz qw\n" + truth_);
    }
    write_text("camera.txt", camera_text());
    if (has_depth_) write_text("depth.txt", list_text("depth", "depth maps"));
    write_text("rgb.txt", list_text("rgb", "color images"));
    if (has_depth_) {
      std::string text;
      for (const std::string& t : times_) {
        text.append(t).append(" rgb/").append(t).append(".png ");
        text.append(t).append(" depth/").append(t).append(".png\n");
      }
      write_text("associations.txt", text);
    }
    finished_ = true;
  }

  std::size_t size() const { return times_.size(); }

 private:
  void check(const Frame& frame) const {
    constexpr double kLeastStep = 1e-6;
    const char* where = "TumWriter::add";
    require(!finished_, where, "frame", "one after finish", "all frames before finish");
    const double t = frame.timestamp;
    require(std::isfinite(t) && std::abs(t) < kLargestTime, where, "timestamp", t,
            "a finite number of seconds below 1e12");
    require(times_.empty() || t - last_ >= kLeastStep * 0.999, where, "timestamp", t,
            "a time at least 1e-6 s after the last frame's");
    require(times_.empty() || fixed(t, 6) != times_.back(), where, "timestamp", t,
            "a time that differs from the last frame's in six digits");
    const cv::Mat& color = frame.color;
    expect_image(color, camera_, color.type() == CV_8UC1 || color.type() == CV_8UC3, "color",
                 "CV_8UC1 or CV_8UC3");
    require(times_.empty() || has_depth_ == !frame.depth.empty(), where, "depth",
            frame.depth.empty() ? "none" : "an image", "depth for all frames or for none");
    if (!frame.depth.empty()) {
      expect_image(frame.depth, camera_, frame.depth.type() == CV_32FC1, "depth", "CV_32FC1");
    }
    if (!frame.mask.empty()) {
      expect_image(frame.mask, camera_, frame.mask.type() == CV_8UC1, "mask", "CV_8UC1");
    }
    require(!frame.T_world_cam || frame.T_world_cam->all_finite(), where, "T_world_cam",
            "a pose that is not finite", "a finite pose");
  }

  void write_image(const char* kind, const std::string& file, const cv::Mat& image) {
    detail::make_folder(folder_ / kind);
    std::vector<unsigned char> bytes;
    const fs::path path = folder_ / kind / file;
    bool good = false;
    try {
      good = cv::imencode(".png", image, bytes,
                          {cv::IMWRITE_PNG_COMPRESSION, options_.png_compression});
    } catch (const cv::Exception& error) {
      throw_io_error(path.string(), "cannot be encoded: " + error.msg);
    }
    if (!good) throw_io_error(path.string(), "cannot be encoded as PNG");
    const auto* data = reinterpret_cast<const char*>(bytes.data());
    write_file_atomically(path.string(), {data, bytes.size()}, false);
  }

  void write_text(const char* file, const std::string& text) {
    write_file_atomically((folder_ / file).string(), text);
  }

  void remove(const fs::path& file) {
    std::error_code error;
    fs::remove(folder_ / file, error);
    if (error) throw_io_error((folder_ / file).string(), "cannot be removed: " + error.message());
  }

  void add_pose(const std::string& time, const RigidTransform& T) {
    constexpr int kDigits = 9;
    const Eigen::Quaterniond q = T.quaternion();
    truth_ += time;
    for (const double v : {T.t.x(), T.t.y(), T.t.z(), q.x(), q.y(), q.z(), q.w()}) {
      truth_ += " " + fixed(v, kDigits);
    }
    truth_ += "\n";
  }

  std::string camera_text() const {
    return "fx " + shortest(camera_.fx) + " fy " + shortest(camera_.fy) + " cx " +
           shortest(camera_.cx) + " cy " + shortest(camera_.cy) + " width " +
           std::to_string(camera_.width) + " height " + std::to_string(camera_.height) + " fps " +
           shortest(options_.fps) + " depth_scale " + shortest(options_.depth_scale) + " bf " +
           shortest(camera_.bf) + "\n";
  }

  std::string list_text(const std::string& folder, const std::string& what) const {
    std::string text = "# " + what + "\n# timestamp filename\n";
    for (const std::string& t : times_) {
      text.append(t).append(" ").append(folder).append("/").append(t).append(".png\n");
    }
    return text;
  }

  fs::path folder_;
  DepthCamera camera_;
  TumWriterOptions options_;
  std::vector<std::string> times_;
  std::string truth_;
  double last_ = 0.0;
  bool has_depth_ = false;
  bool finished_ = false;
};

void TumWriterOptions::validate() const {
  require(std::isfinite(depth_scale) && depth_scale > 0.0, "TumWriterOptions", "depth_scale",
          depth_scale, "a positive number");
  require(std::isfinite(fps) && fps > 0.0, "TumWriterOptions", "fps", fps, "a positive number");
  require(png_compression >= 0 && png_compression <= 9, "TumWriterOptions", "png_compression",
          png_compression, "0 to 9");
}

TumWriter::TumWriter(const fs::path& folder, const DepthCamera& camera,
                     const TumWriterOptions& options)
    : impl_(std::make_unique<Impl>(folder, camera, options)) {}
TumWriter::~TumWriter() = default;
void TumWriter::add(const Frame& frame) { impl_->add(frame); }
void TumWriter::finish() { impl_->finish(); }
std::size_t TumWriter::size() const { return impl_->size(); }

std::size_t write_tum_folder(const Sequence& sequence, const fs::path& folder,
                             const TumWriterOptions& options) {
  TumWriterOptions own = options;
  own.fps = sequence.fps();
  TumWriter writer(folder, sequence.camera(), own);
  for (std::size_t i = 0; i < sequence.size(); ++i) writer.add(sequence.read(i));
  writer.finish();
  return writer.size();
}

}  // namespace dynslam::dataset
