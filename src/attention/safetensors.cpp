#include "dynslam/attention/safetensors.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <set>
#include <utility>

#include <nlohmann/json.hpp>

#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"

namespace dynslam::attention {
namespace {

using nlohmann::json;

// Deeper than a header is: objects in one object, with arrays in them.
constexpr int kMaxDepth = 4;

struct Entry {
  std::string name;
  std::string dtype;
  std::vector<std::int64_t> shape;
  std::uint64_t begin = 0;
  std::uint64_t end = 0;
  std::uint64_t count = 0;
};

[[noreturn]] void refuse(const std::string& file, const std::string& tensor,
                         const std::string& what) {
  throw_io_error(file, "tensor \"" + tensor + "\": " + what);
}

/// The header as JSON, in which no name stands twice.
json parse_header(const std::string& file, const char* text, std::size_t size) {
  std::vector<std::set<std::string>> names;
  std::string twice;
  bool deep = false;
  const auto watch = [&](int depth, json::parse_event_t event, json& value) {
    if (depth > kMaxDepth) deep = true;
    if (event == json::parse_event_t::object_start) {
      names.resize(static_cast<std::size_t>(depth) + 1);
      names.back().clear();
    } else if (event == json::parse_event_t::key) {
      names.resize(static_cast<std::size_t>(depth));
      const auto& name = value.get_ref<const std::string&>();
      if (!names.empty() && !names.back().insert(name).second) twice = name;
    }
    return !deep;
  };
  json header = json::parse(text, text + size, watch, false);
  if (deep || header.is_discarded() || !header.is_object()) {
    throw_io_error(file, "the header is not a JSON object of tensors");
  }
  if (!twice.empty()) throw_io_error(file, "the header has the name \"" + twice + "\" twice");
  return header;
}

std::uint64_t bytes_of_dtype(const std::string& dtype) {
  if (dtype == "F32") return 4;
  if (dtype == "F16" || dtype == "BF16") return 2;
  return 0;
}

Entry parse_entry(const std::string& file, const std::string& name, const json& value,
                  std::uint64_t data_size) {
  Entry entry;
  entry.name = name;
  if (!value.is_object()) refuse(file, name, "expected an object with dtype, shape, data_offsets");
  const auto dtype = value.find("dtype");
  if (dtype == value.end() || !dtype->is_string()) refuse(file, name, "has no dtype");
  entry.dtype = dtype->get<std::string>();
  const std::uint64_t width = bytes_of_dtype(entry.dtype);
  if (width == 0) {
    refuse(file, name, "has dtype \"" + entry.dtype + "\", expected F32, F16 or BF16");
  }
  const auto shape = value.find("shape");
  if (shape == value.end() || !shape->is_array()) refuse(file, name, "has no shape");
  // Stops as soon as the tensor is larger than the file, long before a product can overflow.
  bool empty = false;
  entry.count = 1;
  for (const json& dimension : *shape) {
    if (!dimension.is_number_integer() ||
        (!dimension.is_number_unsigned() && dimension.get<std::int64_t>() < 0) ||
        dimension.get<std::uint64_t>() > std::numeric_limits<std::int32_t>::max()) {
      refuse(file, name, "has a dimension that is not in 0..2147483647");
    }
    const auto size = dimension.get<std::uint64_t>();
    empty = empty || size == 0;
    entry.shape.push_back(static_cast<std::int64_t>(size));
    entry.count *= std::max<std::uint64_t>(size, 1);
    if (entry.count > (std::uint64_t{1} << 31)) refuse(file, name, "is larger than the file");
  }
  if (empty) entry.count = 0;
  const auto offsets = value.find("data_offsets");
  if (offsets == value.end() || !offsets->is_array() || offsets->size() != 2 ||
      !(*offsets)[0].is_number_unsigned() || !(*offsets)[1].is_number_unsigned()) {
    refuse(file, name, "has no data_offsets of two numbers");
  }
  entry.begin = (*offsets)[0].get<std::uint64_t>();
  entry.end = (*offsets)[1].get<std::uint64_t>();
  if (entry.begin > entry.end || entry.end > data_size) {
    refuse(file, name,
           "has data_offsets " + std::to_string(entry.begin) + ".." + std::to_string(entry.end) +
               ", the file has " + std::to_string(data_size) + " bytes of data");
  }
  if (entry.end - entry.begin != entry.count * width) {
    refuse(file, name,
           "has " + std::to_string(entry.end - entry.begin) +
               " bytes of data, its shape asks for " + std::to_string(entry.count * width));
  }
  return entry;
}

float from_bits(std::uint32_t bits) {
  float value;
  std::memcpy(&value, &bits, sizeof(value));
  return value;
}

float widen_half(std::uint32_t half) {
  const std::uint32_t sign = (half & 0x8000U) << 16;
  const std::uint32_t exponent = half >> 10 & 31U;
  const std::uint32_t mantissa = half & 1023U;
  if (exponent == 0) {
    const float magnitude = static_cast<float>(mantissa) * 5.9604644775390625e-8F;  // 2^-24
    return sign != 0 ? -magnitude : magnitude;
  }
  const std::uint32_t widened = exponent == 31 ? 255U : exponent + 112U;
  return from_bits(sign | widened << 23 | mantissa << 13);
}

void copy_values(const Entry& entry, const std::uint8_t* from, float* to) {
  if (entry.dtype == "F32") {
    if (entry.count > 0) std::memcpy(to, from, entry.count * sizeof(float));
    return;
  }
  const bool brain = entry.dtype == "BF16";
  for (std::uint64_t i = 0; i < entry.count; ++i) {
    const std::uint32_t bits = from[2 * i] | static_cast<std::uint32_t>(from[2 * i + 1]) << 8;
    to[i] = brain ? from_bits(bits << 16) : widen_half(bits);
  }
}

/// Entries in the order of their data, which they have to cover without gap or overlap.
std::vector<Entry> parse_entries(const std::string& file, const json& header,
                                 std::uint64_t data_size) {
  std::vector<Entry> entries;
  for (const auto& [name, value] : header.items()) {
    if (name != "__metadata__") entries.push_back(parse_entry(file, name, value, data_size));
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::pair(a.begin, a.end) < std::pair(b.begin, b.end);
  });
  std::uint64_t at = 0;
  for (const Entry& entry : entries) {
    if (entry.begin < at) refuse(file, entry.name, "overlaps the data of another tensor");
    if (entry.begin > at) {
      refuse(file, entry.name,
             "leaves a gap of " + std::to_string(entry.begin - at) + " bytes before its data");
    }
    at = entry.end;
  }
  if (at != data_size) {
    throw_io_error(file, std::to_string(data_size - at) + " bytes of data belong to no tensor");
  }
  return entries;
}

}  // namespace

SafeTensors SafeTensors::parse(Span<const std::uint8_t> bytes, const std::string& name) {
  if (bytes.size() < 8) {
    throw_io_error(name, "is cut short: " + std::to_string(bytes.size()) +
                             " bytes, expected at least the 8 of the header's length");
  }
  std::uint64_t header_size = 0;
  for (std::size_t i = 8; i-- > 0;) header_size = header_size << 8 | bytes[i];
  if (header_size > bytes.size() - 8) {
    throw_io_error(name, "is cut short or no safetensors file: the header says to be " +
                             std::to_string(header_size) + " bytes long, " +
                             std::to_string(bytes.size() - 8) + " follow");
  }
  const auto header_length = static_cast<std::size_t>(header_size);
  const json header =
      parse_header(name, reinterpret_cast<const char*>(bytes.data()) + 8, header_length);
  const std::uint64_t data_size = bytes.size() - 8 - header_size;
  const std::vector<Entry> entries = parse_entries(name, header, data_size);

  SafeTensors result;
  result.name_ = name;
  std::uint64_t total = 0;
  for (const Entry& entry : entries) total += entry.count;
  result.storage_.resize(static_cast<std::size_t>(total));
  std::size_t at = 0;
  for (const Entry& entry : entries) {
    float* values = result.storage_.data() + at;
    copy_values(entry, bytes.data() + 8 + header_length + entry.begin, values);
    const auto count = static_cast<std::size_t>(entry.count);
    result.tensors_.emplace(entry.name, NamedTensor{entry.shape, {values, count}});
    at += count;
  }
  if (const auto metadata = header.find("__metadata__"); metadata != header.end()) {
    if (!metadata->is_object()) throw_io_error(name, "__metadata__ is not an object of texts");
    for (const auto& [key, value] : metadata->items()) {
      if (!value.is_string()) throw_io_error(name, "__metadata__ is not an object of texts");
      result.metadata_[key] = value.get<std::string>();
    }
  }
  return result;
}

SafeTensors SafeTensors::read(const std::string& path) {
  const std::string bytes = read_file(path);
  return parse(as_bytes(bytes), path);
}

bool SafeTensors::contains(std::string_view name) const {
  return tensors_.find(name) != tensors_.end();
}

const NamedTensor& SafeTensors::at(std::string_view name) const {
  const auto found = tensors_.find(name);
  if (found == tensors_.end()) {
    throw_io_error(name_, "there is no tensor \"" + std::string(name) + "\"");
  }
  return found->second;
}

}  // namespace dynslam::attention
