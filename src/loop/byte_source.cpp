#include "loop/byte_source.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#include "dynslam/core/errors.hpp"

namespace dynslam::loop::detail {
namespace {

// A descriptor in digits packs to about a third, whole nodes with long weights to about a quarter.
// Small files may repeat themselves.
constexpr std::uint64_t kMostUnpackedPerByte = 64;
constexpr std::uint64_t kAlwaysUnpacked = 1U << 20;

}  // namespace

void ByteSource::fail(const std::string& what) const {
  throw_io_error(path_, "at byte " + std::to_string(position) + ": " + what);
}

void ByteSource::read_exactly(void* to, std::size_t size, const char* what) {
  const std::size_t got = read(static_cast<std::uint8_t*>(to), size);
  if (got == size) return;
  fail(std::string("the file ends within ") + what + " (" + std::to_string(got) + " of " +
       std::to_string(size) + " bytes)");
}

FileSource::FileSource(const std::string& path, Unpack unpack) : ByteSource(path) {
  struct stat info {};
  if (stat(path.c_str(), &info) != 0) throw_io_error(path, std::strerror(errno));
  if (!S_ISREG(info.st_mode)) throw_io_error(path, "is not a file");
  file_bytes_ = static_cast<std::uint64_t>(info.st_size);
  if (unpack == Unpack::kGzip) {
    gzip_ = gzopen(path.c_str(), "rb");
  } else {
    file_ = std::fopen(path.c_str(), "rb");
  }
  if (file_ == nullptr && gzip_ == nullptr) throw_io_error(path, std::strerror(errno));
}

FileSource::~FileSource() {
  if (file_ != nullptr) std::fclose(file_);
  if (gzip_ != nullptr) gzclose_r(static_cast<gzFile>(gzip_));
}

std::size_t FileSource::read(std::uint8_t* to, std::size_t size) {
  std::size_t got = 0;
  if (file_ != nullptr) {
    got = std::fread(to, 1, size, file_);
    if (got < size && std::ferror(file_) != 0) fail(std::strerror(errno));
  } else {
    const auto gzip = static_cast<gzFile>(gzip_);
    while (got < size) {
      const unsigned piece = static_cast<unsigned>(std::min<std::size_t>(size - got, 1U << 16));
      const int now = gzread(gzip, to + got, piece);
      int error = Z_OK;
      const char* message = gzerror(gzip, &error);
      if (now < 0 || error != Z_OK) {
        fail(std::string("damaged gzip data: ") +
             (error == Z_BUF_ERROR ? "the file is cut short" : message));
      }
      if (now == 0) break;
      got += static_cast<std::size_t>(now);
      const auto packed = static_cast<std::uint64_t>(std::max<z_off_t>(gzoffset(gzip), 0));
      if (position + got > kAlwaysUnpacked + kMostUnpackedPerByte * packed) {
        fail(std::to_string(packed) + " bytes of gzip unpack to more than " +
             std::to_string(kAlwaysUnpacked + kMostUnpackedPerByte * packed) +
             ", which no vocabulary does");
      }
    }
  }
  position += got;
  return got;
}

std::uint64_t FileSource::left() const {
  return file_ != nullptr ? file_bytes_ - std::min(file_bytes_, position) : ByteSource::left();
}

std::size_t MemorySource::read(std::uint8_t* to, std::size_t size) {
  const std::size_t got = std::min<std::size_t>(size, bytes_.size() - position);
  if (got > 0) std::memcpy(to, bytes_.data() + position, got);
  position += got;
  return got;
}

FileSink::FileSink(const std::string& path, Pack pack) : file_(path) {
  if (pack == Pack::kNo) return;
  const int descriptor = ::dup(file_.descriptor());
  if (descriptor < 0) file_.fail(errno);
  gzip_ = gzdopen(descriptor, "wb6");
  if (gzip_ == nullptr) {
    ::close(descriptor);
    file_.fail(ENOMEM);
  }
}

FileSink::~FileSink() {
  if (gzip_ != nullptr) gzclose_w(static_cast<gzFile>(gzip_));
}

void FileSink::write(const void* bytes, std::size_t size) {
  if (gzip_ == nullptr) {
    file_.write(bytes, size);
    return;
  }
  const auto* at = static_cast<const std::uint8_t*>(bytes);
  while (size > 0) {
    const unsigned piece = static_cast<unsigned>(std::min<std::size_t>(size, 1U << 20));
    if (gzwrite(static_cast<gzFile>(gzip_), at, piece) != static_cast<int>(piece))
      file_.fail(errno);
    at += piece;
    size -= piece;
  }
}

void FileSink::commit() {
  if (gzip_ != nullptr) {
    const auto gzip = static_cast<gzFile>(std::exchange(gzip_, nullptr));
    if (gzclose_w(gzip) != Z_OK) file_.fail(errno);
  }
  file_.commit();
}

}  // namespace dynslam::loop::detail
