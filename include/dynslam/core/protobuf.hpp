// Protocol buffers on the wire, as in ONNX files: a message is a sequence of numbered fields.
//
// Enough to read what a schema says and to write it again, without the protobuf library. Nothing
// here owns memory or throws; views are valid as long as the bytes they were made from. O(bytes);
// thread-safe for readers of their own. Source: the encoding guide of protocol buffers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

namespace dynslam::protobuf {

/// How a field is written.
constexpr std::uint32_t kVarint = 0, kFixed64 = 1, kBytes = 2, kFixed32 = 5;

/// One field: a number, or bytes. `encoded` is all of it, key included.
struct Field {
  std::uint32_t number = 0;
  std::uint32_t wire = 0;
  std::uint64_t value = 0;
  std::string_view bytes;
  std::string_view encoded;

  bool is_number() const { return wire == kVarint; }
  bool is_bytes() const { return wire == kBytes; }
};

/// Reads the fields of one message. `next` is false at the end; `broken()` says whether the end
/// came because the bytes are no message.
class FieldReader {
 public:
  explicit FieldReader(std::string_view message) : rest_(message) {}

  bool next(Field& field) {
    if (rest_.empty() || broken_) return false;
    const std::string_view start = rest_;
    const std::uint64_t key = varint();
    field = Field();
    field.number = static_cast<std::uint32_t>(key >> 3);
    field.wire = static_cast<std::uint32_t>(key & 7);
    if (field.wire == kVarint) {
      field.value = varint();
    } else if (field.wire == kFixed64) {
      field.bytes = take(8);
    } else if (field.wire == kBytes) {
      field.bytes = take(varint());
    } else if (field.wire == kFixed32) {
      field.bytes = take(4);
      if (!broken_) {
        std::uint32_t bits = 0;
        for (std::size_t i = 4; i-- > 0;) {
          bits = bits << 8 | static_cast<unsigned char>(field.bytes[i]);
        }
        field.value = bits;
      }
    } else {
      broken_ = true;
    }
    if (key >> 3 == 0 || key >> 32 != 0) broken_ = true;
    if (broken_) return false;
    field.encoded = start.substr(0, start.size() - rest_.size());
    return true;
  }
  bool broken() const { return broken_; }

  std::uint64_t varint() {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      if (rest_.empty()) break;
      const auto byte = static_cast<unsigned char>(rest_.front());
      rest_.remove_prefix(1);
      value |= static_cast<std::uint64_t>(byte & 127) << shift;
      if (byte < 128) return value;
    }
    broken_ = true;
    return 0;
  }
  bool at_end() const { return rest_.empty() || broken_; }

 private:
  std::string_view take(std::uint64_t count) {
    if (broken_ || count > rest_.size()) {
      broken_ = true;
      return {};
    }
    const std::string_view taken = rest_.substr(0, static_cast<std::size_t>(count));
    rest_.remove_prefix(static_cast<std::size_t>(count));
    return taken;
  }

  std::string_view rest_;
  bool broken_ = false;
};

/// The bytes of the first field with this number that holds any; empty if there is none.
inline std::string_view bytes_of(std::string_view message, std::uint32_t number) {
  FieldReader reader(message);
  Field field;
  while (reader.next(field)) {
    if (field.number == number && field.is_bytes()) return field.bytes;
  }
  return {};
}

/// Each of these appends to `out`.
inline void put_varint(std::string& out, std::uint64_t value) {
  while (value >= 128) {
    out.push_back(static_cast<char>((value & 127) | 128));
    value >>= 7;
  }
  out.push_back(static_cast<char>(value));
}
inline void put_number(std::string& out, std::uint32_t field, std::uint64_t value) {
  put_varint(out, std::uint64_t{field} << 3);
  put_varint(out, value);
}
inline void put_bytes(std::string& out, std::uint32_t field, std::string_view bytes) {
  put_varint(out, std::uint64_t{field} << 3 | kBytes);
  put_varint(out, bytes.size());
  out.append(bytes);
}

}  // namespace dynslam::protobuf
