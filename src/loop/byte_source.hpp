// Reading files that are not to be trusted, byte by byte, and writing files as a whole.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "dynslam/core/files.hpp"
#include "dynslam/core/span.hpp"

namespace dynslam::loop::detail {

/// Where bytes come from. read() returns fewer than asked for only at the end.
class ByteSource {
 public:
  explicit ByteSource(std::string path) : path_(std::move(path)) {}
  virtual ~ByteSource() = default;
  ByteSource(const ByteSource&) = delete;
  ByteSource& operator=(const ByteSource&) = delete;

  virtual std::size_t read(std::uint8_t* to, std::size_t size) = 0;
  /// Most bytes that may still come.
  virtual std::uint64_t left() const { return ~std::uint64_t{0}; }
  const std::string& path() const { return path_; }
  /// Throws IoError: path, position, what.
  [[noreturn]] void fail(const std::string& what) const;

  std::uint64_t position = 0;  // bytes delivered so far

  /// `size` bytes for `what`, or an IoError.
  void read_exactly(void* to, std::size_t size, const char* what);
  template <typename T>
  T number(const char* what) {
    T value;
    read_exactly(&value, sizeof(value), what);
    return value;
  }

 private:
  std::string path_;
};

/// A file as it is, or, if it is gzip, what it unpacks to. Unpacking stops with an IoError where
/// it yields more than a vocabulary can: its descriptors are close to random.
class FileSource : public ByteSource {
 public:
  enum class Unpack { kNo, kGzip };
  FileSource(const std::string& path, Unpack unpack);
  ~FileSource() override;
  std::size_t read(std::uint8_t* to, std::size_t size) override;
  std::uint64_t left() const override;

 private:
  std::FILE* file_ = nullptr;
  void* gzip_ = nullptr;
  std::uint64_t file_bytes_ = 0;
};

/// Bytes in memory, for tests and fuzzing.
class MemorySource : public ByteSource {
 public:
  MemorySource(std::string path, Span<const std::uint8_t> bytes)
      : ByteSource(std::move(path)), bytes_(bytes) {}
  std::size_t read(std::uint8_t* to, std::size_t size) override;
  std::uint64_t left() const override { return bytes_.size() - position; }

 private:
  Span<const std::uint8_t> bytes_;
};

/// Writes a file, packed or not, that appears complete or not at all.
class FileSink {
 public:
  enum class Pack { kNo, kGzip };
  explicit FileSink(const std::string& path, Pack pack = Pack::kNo);
  ~FileSink();
  FileSink(const FileSink&) = delete;
  FileSink& operator=(const FileSink&) = delete;

  void write(const void* bytes, std::size_t size);
  void write(std::string_view text) { write(text.data(), text.size()); }
  template <typename T>
  void number(T value) {
    write(&value, sizeof(value));
  }
  void commit();

 private:
  AtomicFile file_;
  void* gzip_ = nullptr;
};

}  // namespace dynslam::loop::detail
