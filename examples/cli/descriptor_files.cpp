#include "descriptor_files.hpp"

#include <algorithm>
#include <atomic>
#include <cctype>
#include <exception>
#include <filesystem>
#include <fstream>
#include <limits>
#include <mutex>
#include <string_view>
#include <thread>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/opencv.hpp"
#include "dynslam/features/orb.hpp"

#include "progress.hpp"

namespace dynslam::cli {
namespace {

namespace fs = std::filesystem;

std::string extension_of(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

bool is_descriptor_file(const fs::path& path) { return extension_of(path) == ".npy"; }

bool is_picture(const fs::path& path) {
  constexpr std::string_view kEndings[] = {".png", ".jpg", ".jpeg", ".bmp", ".pgm",
                                           ".ppm", ".tif", ".tiff", ".webp"};
  const std::string extension = extension_of(path);
  if (std::find(std::begin(kEndings), std::end(kEndings), extension) == std::end(kEndings))
    return false;
  // Beside the pictures of a recording lie others that are none of a camera.
  const std::string folder = path.parent_path().filename().string();
  const std::string stem = path.stem().string();
  return folder != "depth" && folder != "mask" && stem.find("_GT") == std::string::npos;
}

std::vector<fs::path> files_of(const std::vector<std::string>& paths, std::size_t every) {
  std::vector<fs::path> files;
  for (const std::string& path : paths) {
    if (!fs::exists(path)) throw_io_error(path, "does not exist");
    if (!fs::is_directory(path)) {
      files.emplace_back(path);
      continue;
    }
    std::vector<fs::path> found;
    for (const auto& entry : fs::recursive_directory_iterator(path)) {
      if (!entry.is_regular_file()) continue;
      if (is_picture(entry.path()) || is_descriptor_file(entry.path())) found.push_back(entry);
    }
    if (found.empty()) throw_io_error(path, "holds neither pictures nor .npy files");
    std::sort(found.begin(), found.end());
    for (std::size_t i = 0; i < found.size(); i += every) files.push_back(found[i]);
  }
  return files;
}

struct Rows {
  std::vector<std::uint8_t> bytes;
  int width = 0;
};

/// NumPy's format 1 to 3: magic, version, length of a header, the header (a Python dictionary),
/// the array by rows.
Rows read_npy(const fs::path& path) {
  const std::string name = path.string();
  std::ifstream file(path, std::ios::binary);
  char start[8] = {};
  file.read(start, sizeof(start));
  if (!file || std::string_view(start, 6) != std::string_view("\x93NUMPY", 6))
    throw_io_error(name, "is no .npy file");
  const int length_bytes = start[6] == 1 ? 2 : 4;
  std::uint32_t length = 0;
  file.read(reinterpret_cast<char*>(&length), length_bytes);
  if (!file || length > 65536) throw_io_error(name, "damaged header");
  std::string header(length, ' ');
  file.read(header.data(), static_cast<std::streamsize>(length));
  if (!file) throw_io_error(name, "ends within the header");
  if (header.find("'|u1'") == std::string::npos && header.find("'<u1'") == std::string::npos)
    throw_io_error(name, "holds something else than uint8: " + header);
  if (header.find("True") != std::string::npos) throw_io_error(name, "is stored by columns");
  std::uint64_t rows = 0;
  std::uint64_t width = 0;
  const std::size_t shape = header.find('(');
  if (shape == std::string::npos ||
      std::sscanf(header.c_str() + shape, "(%lu, %lu)", &rows, &width) != 2)
    throw_io_error(name, "is no matrix: " + header);
  const std::uint64_t left = fs::file_size(path) - static_cast<std::uint64_t>(file.tellg());
  if (width < 1 || width > 256 || rows > left / width || rows * width != left)
    throw_io_error(name, std::to_string(rows) + " x " + std::to_string(width) +
                             " bytes, the file " + "has " + std::to_string(left));
  Rows result;
  result.width = static_cast<int>(width);
  result.bytes.resize(rows * width);
  file.read(reinterpret_cast<char*>(result.bytes.data()),
            static_cast<std::streamsize>(result.bytes.size()));
  if (!file) throw_io_error(name, "cannot be read");
  return result;
}

Rows extract(const fs::path& path, features::OrbExtractor& extractor) {
  const cv::Mat gray = cv::imread(path.string(), cv::IMREAD_GRAYSCALE);
  if (gray.empty()) throw_io_error(path.string(), "is no picture that can be read");
  std::vector<cv::KeyPoint> keypoints;
  cv::Mat descriptors;
  extractor.extract(as_view<const std::uint8_t>(gray), {}, keypoints, descriptors);
  Rows result;
  result.width = features::kOrbDescriptorBytes;
  result.bytes.assign(descriptors.datastart, descriptors.dataend);
  return result;
}

/// Rows of each file, on several threads; the calling one shows how far they are.
std::vector<Rows> read_all(const std::vector<fs::path>& files, int features, int threads) {
  std::vector<Rows> all(files.size());
  std::atomic<std::size_t> next{0};
  std::exception_ptr error;
  std::mutex error_mutex;
  Progress progress("descriptors", files.size());
  const auto run = [&](bool shows) {
    try {
      features::OrbOptions options;
      options.max_features = features;
      features::OrbExtractor extractor(options);
      for (std::size_t i = next++; i < files.size(); i = next++) {
        all[i] = is_descriptor_file(files[i]) ? read_npy(files[i]) : extract(files[i], extractor);
        if (shows) progress.update(std::min<std::size_t>(next, files.size()));
      }
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
      next = files.size();
    }
  };
  std::vector<std::thread> helpers;
  for (int t = 1; t < threads; ++t) helpers.emplace_back(run, false);
  run(true);
  for (std::thread& helper : helpers) helper.join();
  if (error) std::rethrow_exception(error);
  return all;
}

}  // namespace

DescriptorsView TrainingSet::view() const {
  return {bytes.data(), descriptor_bytes, static_cast<int>(rows())};
}

TrainingSet read_training_set(const std::vector<std::string>& paths, int features,
                              std::size_t every, int threads) {
  const std::vector<fs::path> files = files_of(paths, every);
  std::vector<Rows> all = read_all(files, features, threads);
  TrainingSet set;
  for (std::size_t i = 0; i < all.size(); ++i) {
    Rows& rows = all[i];
    ++(is_descriptor_file(files[i]) ? set.files : set.images);
    if (rows.bytes.empty()) continue;
    if (set.descriptor_bytes == 0) set.descriptor_bytes = rows.width;
    if (rows.width != set.descriptor_bytes)
      throw_io_error(files[i].string(), "descriptors of " + std::to_string(rows.width) +
                                            " bytes among those of " +
                                            std::to_string(set.descriptor_bytes));
    set.bytes.insert(set.bytes.end(), rows.bytes.begin(), rows.bytes.end());
    rows = {};
    set.image_ends.push_back(set.rows());
  }
  if (set.rows() > static_cast<std::size_t>(std::numeric_limits<int>::max()))
    throw InvalidArgument("vocab train: more than 2^31 descriptors");
  return set;
}

}  // namespace dynslam::cli
