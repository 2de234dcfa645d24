#include "attention/files.hpp"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>

#include "dynslam/core/errors.hpp"

namespace dynslam::attention::detail {

std::vector<std::uint8_t> read_file(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) throw_io_error(path, "there is no such file");
  if (std::filesystem::is_directory(path, error)) throw_io_error(path, "is a folder, not a file");
  std::ifstream stream(path, std::ios::binary);
  stream.seekg(0, std::ios::end);
  const std::streamoff size = stream.tellg();
  if (!stream || size < 0) throw_io_error(path, "cannot be read");
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(size));
  stream.seekg(0);
  stream.read(reinterpret_cast<char*>(bytes.data()), size);
  if (!stream) throw_io_error(path, "cannot be read");
  return bytes;
}

void write_file(const std::string& path, const std::string& bytes) {
  const std::string beside = path + ".part";
  std::error_code error;
  {
    std::ofstream stream(beside, std::ios::binary | std::ios::trunc);
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    stream.close();
    if (!stream) {
      std::filesystem::remove(beside, error);
      throw_io_error(path, "cannot be written");
    }
  }
  std::filesystem::rename(beside, path, error);
  if (error) {
    std::error_code ignored;
    std::filesystem::remove(beside, ignored);
    throw_io_error(path, "cannot be written: " + error.message());
  }
}

}  // namespace dynslam::attention::detail
