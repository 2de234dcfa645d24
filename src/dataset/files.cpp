#include "dataset/files.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdio>
#include <memory>
#include <system_error>

#if defined(__unix__) || defined(__APPLE__)
#include <unistd.h>
#endif

#include "dynslam/core/errors.hpp"
#include "dynslam/dataset/parsing.hpp"

namespace dynslam::dataset::detail {
namespace {

struct Closer {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, Closer>;

std::string reason(int error) {
  return error == 0 ? "unknown reason" : std::generic_category().message(error);
}

// 0, or the number of what went wrong.
int write_and_close(const fs::path& path, std::string_view content, bool durable) {
  errno = 0;
  File file(std::fopen(path.string().c_str(), "wb"));
  if (!file) return errno;
  bool good = std::fwrite(content.data(), 1, content.size(), file.get()) == content.size();
  good = good && std::fflush(file.get()) == 0;
#if defined(__unix__) || defined(__APPLE__)
  if (durable) good = good && ::fsync(::fileno(file.get())) == 0;
#else
  static_cast<void>(durable);
#endif
  const int error = errno;
  if (!good) return error == 0 ? EIO : error;
  // A full disk may show itself only now.
  return std::fclose(file.release()) == 0 ? 0 : (errno == 0 ? EIO : errno);
}

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
  if (!fs::exists(status)) throw_io_error(path.string(), "there is no such file");
  if (!fs::is_regular_file(status)) throw_io_error(path.string(), "is no regular file");
  errno = 0;
  const File file(std::fopen(path.string().c_str(), "rb"));
  if (!file) throw_io_error(path.string(), "cannot be opened: " + reason(errno));
  std::string content;
  const std::uintmax_t size = fs::file_size(path, error);
  if (!error) content.resize(static_cast<std::size_t>(size));
  const std::size_t got = std::fread(content.data(), 1, content.size(), file.get());
  if (std::ferror(file.get()) != 0) {
    throw_io_error(path.string(), "cannot be read: " + reason(errno));
  }
  content.resize(got);
  return content;
}

void write_file(const fs::path& path, std::string_view content, bool durable) {
  fs::path temporary = path;
  temporary += ".tmp";
  std::error_code ignored;
  if (const int error = write_and_close(temporary, content, durable)) {
    fs::remove(temporary, ignored);
    throw_io_error(path.string(), "cannot be written: " + reason(error));
  }
  std::error_code error;
  fs::rename(temporary, path, error);
  if (error) {
    fs::remove(temporary, ignored);
    throw_io_error(path.string(), "cannot be written: " + error.message());
  }
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
