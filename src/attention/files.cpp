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

}  // namespace dynslam::attention::detail
