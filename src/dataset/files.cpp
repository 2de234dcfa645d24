#include "dataset/files.hpp"

#include <algorithm>
#include <cctype>
#include <system_error>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/dataset/parsing.hpp"

namespace dynslam::dataset::detail {
namespace {

bool is_image_name(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  constexpr std::string_view kKnown[] = {".png", ".jpg", ".jpeg", ".bmp", ".pgm",
                                         ".ppm", ".tif", ".tiff", ".webp"};
  return std::find(std::begin(kKnown), std::end(kKnown), extension) != std::end(kKnown);
}

}  // namespace

std::string read_file(const fs::path& path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::exists(status) && !fs::is_regular_file(status)) {
    throw_io_error(path.string(), "is no regular file");
  }
  return dynslam::read_file(path.string());
}

void make_folder(const fs::path& path) {
  std::error_code error;
  fs::create_directories(path, error);
  if (error || !fs::is_directory(path, error)) {
    throw_io_error(path.string(), "cannot be made a folder: " +
                                      (error ? error.message() : "it is something else"));
  }
}

void expect_folder(const fs::path& path) {
  std::error_code error;
  if (!fs::exists(path, error)) throw_io_error(path.string(), "there is no such folder");
  if (!fs::is_directory(path, error)) throw_io_error(path.string(), "is no folder, expected one");
  const fs::directory_iterator opened(path, error);
  if (error) throw_io_error(path.string(), "cannot be opened: " + error.message());
}

std::vector<fs::path> list_images(const fs::path& folder) {
  expect_folder(folder);
  std::vector<fs::path> images;
  std::error_code error;
  for (fs::directory_iterator i(folder, error), end; !error && i != end; i.increment(error)) {
    std::error_code gone;
    if (is_image_name(i->path()) && i->is_regular_file(gone)) images.push_back(i->path());
  }
  if (error) throw_io_error(folder.string(), "cannot be listed: " + error.message());
  std::sort(images.begin(), images.end(), [](const fs::path& a, const fs::path& b) {
    return natural_less(a.filename().string(), b.filename().string());
  });
  return images;
}

std::string folder_name(const fs::path& folder) {
  std::error_code error;
  const fs::path whole = fs::canonical(folder, error);
  return (error ? folder : whole).filename().string();
}

}  // namespace dynslam::dataset::detail
