#include "dataset/image_file.hpp"

#include <array>
#include <cstdint>
#include <cstring>
#include <string>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "dynslam/core/errors.hpp"

#include "dataset/files.hpp"

namespace dynslam::dataset::detail {
namespace {

// A header that asks for more is taken for damage, not for a request of gigabytes.
constexpr std::uint64_t kMostPixels = std::uint64_t{1} << 27;
constexpr std::string_view kPngSignature = "\x89PNG\r\n\x1a\n";

std::uint32_t big_endian(std::string_view bytes, std::size_t at, std::size_t count) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < count; ++i) {
    value = value << 8 | static_cast<unsigned char>(bytes[at + i]);
  }
  return value;
}

using CrcTables = std::array<std::array<std::uint32_t, 256>, 8>;

CrcTables make_crc_tables() {
  constexpr std::uint32_t kPolynomial = 0xEDB88320U;  // CRC-32 of PNG, bits reversed
  CrcTables tables{};
  for (std::uint32_t n = 0; n < 256; ++n) {
    std::uint32_t c = n;
    for (int bit = 0; bit < 8; ++bit) c = (c & 1U) != 0 ? kPolynomial ^ (c >> 1) : c >> 1;
    tables[0][n] = c;
  }
  for (std::size_t k = 1; k < 8; ++k) {
    for (std::size_t n = 0; n < 256; ++n) {
      const std::uint32_t c = tables[k - 1][n];
      tables[k][n] = c >> 8 ^ tables[0][c & 255U];
    }
  }
  return tables;
}

// Eight bytes at a time, or checking a PNG would take a third of the time of decoding it.
std::uint32_t crc32(std::string_view bytes) {
  static const CrcTables kTables = make_crc_tables();
  const CrcTables& t = kTables;
  std::uint32_t c = 0xFFFFFFFFU;
  const auto byte = [&](std::size_t i) -> std::uint32_t {
    return static_cast<unsigned char>(bytes[i]);
  };
  std::size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    c ^= byte(i) | byte(i + 1) << 8 | byte(i + 2) << 16 | byte(i + 3) << 24;
    c = t[7][c & 255U] ^ t[6][c >> 8 & 255U] ^ t[5][c >> 16 & 255U] ^ t[4][c >> 24] ^
        t[3][byte(i + 4)] ^ t[2][byte(i + 5)] ^ t[1][byte(i + 6)] ^ t[0][byte(i + 7)];
  }
  for (; i < bytes.size(); ++i) c = t[0][(c ^ byte(i)) & 255U] ^ c >> 8;
  return c ^ 0xFFFFFFFFU;
}

const char* find_png_damage(std::string_view bytes) {
  constexpr const char* kCutShort = "the PNG file is cut short";
  std::size_t at = kPngSignature.size();
  bool first = true;
  while (true) {
    if (bytes.size() - at < 12) return kCutShort;  // length, type and checksum
    const std::size_t length = big_endian(bytes, at, 4);
    if (bytes.size() - at - 12 < length) return kCutShort;
    const std::string_view type = bytes.substr(at + 4, 4);
    if (crc32(bytes.substr(at + 4, length + 4)) != big_endian(bytes, at + 8 + length, 4)) {
      return "the PNG file is corrupt (a checksum is wrong)";
    }
    if (first) {
      if (type != "IHDR" || length != 13) return "the PNG file has no header";
      const std::uint64_t pixels =
          std::uint64_t{big_endian(bytes, at + 8, 4)} * big_endian(bytes, at + 12, 4);
      if (pixels > kMostPixels) return "the PNG file claims more than 2^27 pixels";
      first = false;
    }
    if (type == "IEND") return nullptr;
    at += 12 + length;
  }
}

bool is_jpeg_frame_header(unsigned marker) {
  return marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
}

// The marker at or after `at` in entropy-coded data, skipping stuffed bytes and restarts.
std::size_t skip_scan(std::string_view bytes, std::size_t at) {
  while (at + 1 < bytes.size()) {
    const void* found = std::memchr(bytes.data() + at, 0xFF, bytes.size() - at - 1);
    if (found == nullptr) break;
    at = static_cast<std::size_t>(static_cast<const char*>(found) - bytes.data());
    const auto next = static_cast<unsigned char>(bytes[at + 1]);
    if (next != 0x00 && next != 0xFF && !(next >= 0xD0 && next <= 0xD7)) return at;
    at += next == 0xFF ? 1 : 2;
  }
  return bytes.size();
}

const char* find_jpeg_damage(std::string_view bytes) {
  constexpr const char* kCutShort = "the JPEG file is cut short";
  std::size_t at = 2;
  bool has_scan = false;
  while (true) {
    if (at + 2 > bytes.size()) return kCutShort;
    if (static_cast<unsigned char>(bytes[at]) != 0xFF) return "the JPEG file is corrupt";
    const auto marker = static_cast<unsigned char>(bytes[at + 1]);
    if (marker == 0xFF) {  // fill
      ++at;
      continue;
    }
    if (marker == 0xD9) return has_scan ? nullptr : "the JPEG file holds no image";
    if (at + 4 > bytes.size()) return kCutShort;
    const std::size_t length = big_endian(bytes, at + 2, 2);
    if (length < 2) return "the JPEG file is corrupt";
    if (bytes.size() - at - 2 < length) return kCutShort;
    if (is_jpeg_frame_header(marker)) {
      if (length < 8) return "the JPEG file is corrupt";
      const std::uint64_t pixels =
          std::uint64_t{big_endian(bytes, at + 5, 2)} * big_endian(bytes, at + 7, 2);
      if (pixels > kMostPixels) return "the JPEG file claims more than 2^27 pixels";
    }
    at += 2 + length;
    if (marker == 0xDA) {
      has_scan = true;
      at = skip_scan(bytes, at);
    }
  }
}

cv::Mat decode(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  if (bytes.empty()) throw_io_error(path.string(), "the image file is empty");
  if (const char* damage = find_damage(bytes)) throw_io_error(path.string(), damage);
  constexpr std::size_t kLargestFile = std::size_t{1} << 30;
  if (bytes.size() > kLargestFile) throw_io_error(path.string(), "the image file is over 1 GiB");
  cv::Mat image;
  try {
    const cv::Mat buffer(1, static_cast<int>(bytes.size()), CV_8UC1,
                         const_cast<char*>(bytes.data()));
    image = cv::imdecode(buffer, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception& error) {
    throw_io_error(path.string(), "the image cannot be decoded: " + error.msg);
  }
  if (image.empty()) throw_io_error(path.string(), "is no image that can be decoded");
  return image;
}

[[noreturn]] void fail_type(const std::filesystem::path& path, const cv::Mat& image,
                            const char* expected) {
  throw_io_error(path.string(), "the image is of type " + cv::typeToString(image.type()) +
                                    ", expected " + expected);
}

}  // namespace

const char* find_damage(std::string_view bytes) {
  if (bytes.substr(0, kPngSignature.size()) == kPngSignature) return find_png_damage(bytes);
  if (bytes.substr(0, 3) == "\xFF\xD8\xFF") return find_jpeg_damage(bytes);
  return nullptr;
}

cv::Mat read_color(const std::filesystem::path& path) {
  cv::Mat image = decode(path);
  if (image.type() == CV_8UC4) cv::cvtColor(image, image, cv::COLOR_BGRA2BGR);
  if (image.type() != CV_8UC1 && image.type() != CV_8UC3) {
    fail_type(path, image, "8 bits a channel, grey or colour");
  }
  return image;
}

cv::Mat read_depth(const std::filesystem::path& path, double scale) {
  const cv::Mat raw = decode(path);
  if (raw.type() != CV_16UC1) fail_type(path, raw, "16-bit grey (CV_16UC1) for depth");
  cv::Mat depth;
  raw.convertTo(depth, CV_32F, 1.0 / scale);
  return depth;
}

cv::Mat read_mask(const std::filesystem::path& path) {
  cv::Mat mask = decode(path);
  if (mask.type() != CV_8UC1) fail_type(path, mask, "8-bit grey (CV_8UC1) for a mask");
  return mask;
}

}  // namespace dynslam::dataset::detail
