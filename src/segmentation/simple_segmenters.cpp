#include "dynslam/segmentation/simple_segmenters.hpp"

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <system_error>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

#include "segmentation/onnx_file.hpp"
#include "segmentation/stopwatch.hpp"

namespace dynslam::segmentation {
namespace {

namespace fs = std::filesystem;

// Whether the bytes are a whole PNG: signature, then chunks up to IEND. libpng would complain on
// stderr about what is not.
bool is_whole_png(const std::string& bytes) {
  constexpr std::array<unsigned char, 8> kSignature = {137, 'P', 'N', 'G', 13, 10, 26, 10};
  const auto* at = reinterpret_cast<const unsigned char*>(bytes.data());
  if (bytes.size() < 8 || !std::equal(kSignature.begin(), kSignature.end(), at)) return false;
  std::size_t pos = 8;
  while (bytes.size() - pos >= 12) {
    const std::size_t length = static_cast<std::size_t>(at[pos]) << 24 |
                               static_cast<std::size_t>(at[pos + 1]) << 16 |
                               static_cast<std::size_t>(at[pos + 2]) << 8 | at[pos + 3];
    if (bytes.compare(pos + 4, 4, "IEND") == 0) return true;
    if (length > bytes.size() - pos - 12) return false;
    pos += 12 + length;
  }
  return false;
}

cv::Mat read_labels(const std::string& path) {
  const std::string bytes = read_file_bytes(path);
  if (!is_whole_png(bytes)) throw_io_error(path, "is not a PNG image, or is cut short");
  cv::Mat labels;
  try {
    const cv::Mat raw(1, static_cast<int>(bytes.size()), CV_8UC1, const_cast<char*>(bytes.data()));
    labels = cv::imdecode(raw, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    labels.release();
  }
  if (labels.empty()) throw_io_error(path, "cannot be decoded as a PNG image");
  if (labels.type() == CV_8UC3) {
    std::vector<cv::Mat> planes;
    cv::split(labels, planes);
    const bool grey =
        cv::countNonZero(planes[0] != planes[1]) + cv::countNonZero(planes[0] != planes[2]) == 0;
    if (!grey) throw_io_error(path, "is a colour image; expected labels in one channel");
    labels = planes[0];
  }
  if (labels.type() != CV_8UC1 && labels.type() != CV_16UC1) {
    throw_io_error(path, "has pixels of type " + cv::typeToString(labels.type()) +
                             "; expected labels of 8 or 16 bits in one channel");
  }
  return labels;
}

// Bounding boxes of all values, in one pass over the image.
template <typename T>
std::vector<Instance> split_labels(const cv::Mat& labels) {
  struct Extent {
    int left = 0, top = 0, right = -1, bottom = -1;
  };
  std::map<int, Extent> extents;
  int last_value = 0;
  Extent* last = nullptr;
  for (int y = 0; y < labels.rows; ++y) {
    const T* row = labels.ptr<T>(y);
    for (int x = 0; x < labels.cols; ++x) {
      const int value = row[x];
      if (value == 0) continue;
      if (last == nullptr || value != last_value) {
        const auto [entry, is_new] = extents.try_emplace(value);
        last = &entry->second;
        last_value = value;
        if (is_new) *last = {x, y, x, y};
      }
      last->left = std::min(last->left, x);
      last->right = std::max(last->right, x);
      last->bottom = y;
    }
  }
  std::vector<Instance> instances;
  for (const auto& [value, e] : extents) {
    Instance instance;
    instance.score = 1.0F;
    instance.box = cv::Rect(e.left, e.top, e.right - e.left + 1, e.bottom - e.top + 1);
    instance.mask = labels(instance.box) == value;
    instance.label = value;
    instances.push_back(std::move(instance));
  }
  return instances;
}

}  // namespace

Segmentation NullSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  require_segmentable("NullSegmenter::segment", image, frame);
  Segmentation result;
  result.width = image.cols;
  result.height = image.rows;
  return result;
}

SegmenterInfo NullSegmenter::info() const {
  SegmenterInfo info;
  info.kind = "none";
  return info;
}

RecordedSegmenter::RecordedSegmenter(const std::string& folder, const RecordedOptions& options)
    : folder_(folder), options_(options) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) {
    throw_io_error(folder, "is not a folder; expected one with a PNG mask for each frame");
  }
  fs::directory_iterator entry(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    std::string extension = entry->path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (extension == ".png") files_[entry->path().stem().string()] = entry->path().string();
  }
  if (error) throw_io_error(folder, "cannot be listed: " + error.message());
  if (files_.empty()) throw_io_error(folder, "holds no PNG file; expected a mask for each frame");
}

Segmentation RecordedSegmenter::segment(const cv::Mat& image, const FrameInfo& frame) {
  const Stopwatch total;
  require_segmentable("RecordedSegmenter::segment", image, frame);
  require(!frame.name.empty(), "RecordedSegmenter::segment", "frame.name", "an empty name",
          "the name that the frame's mask has");
  Segmentation result;
  result.width = image.cols;
  result.height = image.rows;
  const std::string stem = frame_stem(frame.name);
  const auto file = files_.find(stem);
  if (file == files_.end()) {
    if (options_.missing_is_empty) return result;
    throw_io_error((fs::path(folder_) / (stem + ".png")).string(),
                   "there is no such mask for the frame " + frame.name);
  }
  const cv::Mat labels = read_labels(file->second);
  if (labels.size() != image.size()) {
    throw_io_error(file->second, "has " + std::to_string(labels.cols) + "x" +
                                     std::to_string(labels.rows) + " pixels; expected " +
                                     std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                                     " as the image has");
  }
  result.instances = instances_of_labels(labels);
  result.total_ms = total.ms();
  return result;
}

SegmenterInfo RecordedSegmenter::info() const {
  SegmenterInfo info;
  info.kind = "recorded";
  info.source = folder_;
  return info;
}

std::vector<Instance> instances_of_labels(const cv::Mat& labels) {
  if (labels.empty()) return {};
  require(labels.dims == 2 && (labels.type() == CV_8UC1 || labels.type() == CV_16UC1),
          "instances_of_labels", "labels", cv::typeToString(labels.type()),
          "CV_8UC1 or CV_16UC1 in two dimensions");
  return labels.type() == CV_8UC1 ? split_labels<std::uint8_t>(labels)
                                  : split_labels<std::uint16_t>(labels);
}

}  // namespace dynslam::segmentation
