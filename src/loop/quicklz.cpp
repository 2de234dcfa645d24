#include "loop/quicklz.hpp"

#include <algorithm>
#include <cstring>

namespace dynslam::loop::detail {
namespace {

constexpr std::size_t kHashes = 4096;
constexpr std::uint32_t kNone = 0xFFFFFFFFU;
constexpr std::size_t kShortHeader = 3;
constexpr std::size_t kFewestMatched = 3;
constexpr std::size_t kMostMatched = 255;
// Other readers copy several bytes at a time: matches keep away from the end, and from themselves.
constexpr std::size_t kLastMatchStart = 10;
constexpr std::size_t kLastMatchEnd = 5;
constexpr std::size_t kLeastDistance = 3;

std::size_t hash_of(const std::uint8_t* at) {
  const std::uint32_t three =
      at[0] | static_cast<std::uint32_t>(at[1]) << 8 | static_cast<std::uint32_t>(at[2]) << 16;
  return ((three >> 12) ^ three) & (kHashes - 1);
}

std::uint32_t word_at(const std::uint8_t* at) {
  std::uint32_t word;
  std::memcpy(&word, at, sizeof(word));
  return word;
}

/// Where three bytes of each hash were last seen; the same while packing and unpacking.
class Seen {
 public:
  Seen() { std::fill(std::begin(places_), std::end(places_), kNone); }
  std::uint32_t place(std::size_t hash) const { return places_[hash]; }
  /// Notes the places that are not noted yet, below `end`.
  void note_until(const std::uint8_t* bytes, std::size_t end) {
    for (; next_ < end; ++next_)
      places_[hash_of(bytes + next_)] = static_cast<std::uint32_t>(next_);
  }
  /// Leaves the places before `next` out.
  void skip_to(std::size_t next) { next_ = next; }

 private:
  std::uint32_t places_[kHashes];
  std::size_t next_ = 0;
};

}  // namespace

std::optional<QuickLzHeader> read_quicklz_header(Span<const std::uint8_t> bytes) {
  if (bytes.size() < kLongQuickLzHeader) return std::nullopt;
  const std::uint8_t flags = bytes[0];
  const std::uint8_t level_and_buffer = flags & 0x3CU;
  QuickLzHeader header;
  header.packed = (flags & 1U) != 0;
  if ((flags & 0x40U) == 0 || level_and_buffer != 0x04U) return std::nullopt;
  const bool wide = (flags & 2U) != 0;
  header.header_bytes = wide ? kLongQuickLzHeader : kShortHeader;
  header.packet_bytes = wide ? word_at(bytes.data() + 1) : bytes[1];
  header.unpacked_bytes = wide ? word_at(bytes.data() + 5) : bytes[2];
  if (header.packet_bytes < header.header_bytes) return std::nullopt;
  return header;
}

bool unpack_quicklz(Span<const std::uint8_t> packet, std::vector<std::uint8_t>& to) {
  const auto header = read_quicklz_header(packet);
  if (!header || header->packet_bytes != packet.size()) return false;
  const std::size_t begin = to.size();
  const std::size_t size = header->unpacked_bytes;
  const std::uint8_t* in = packet.data() + header->header_bytes;
  const std::uint8_t* const end = packet.data() + packet.size();
  if (!header->packed) {
    if (static_cast<std::size_t>(end - in) != size) return false;
    to.insert(to.end(), in, end);
    return true;
  }
  to.resize(begin + size);
  std::uint8_t* const out = to.data() + begin;
  const auto damaged = [&] {
    to.resize(begin);
    return false;
  };
  Seen seen;
  std::size_t at = 0;
  std::uint32_t flags = 1;
  while (at < size) {
    if (flags == 1) {
      if (end - in < 4) return damaged();
      flags = word_at(in);
      in += 4;
      if (flags == 0) return damaged();
      continue;
    }
    const bool match = (flags & 1U) != 0;
    flags >>= 1;
    if (!match) {
      if (in == end) return damaged();
      out[at++] = *in++;
      if (at >= 3) seen.note_until(out, at - 2);
      continue;
    }
    if (end - in < 2) return damaged();
    const std::uint32_t code = in[0] | static_cast<std::uint32_t>(in[1]) << 8;
    std::size_t length = (code & 15U) + 2;
    in += 2;
    if ((code & 15U) == 0) {
      if (in == end) return damaged();
      length = *in++;
    }
    const std::uint32_t from = seen.place(code >> 4);
    if (from == kNone || length < kFewestMatched || length > size - at) return damaged();
    for (std::size_t i = 0; i < length; ++i) out[at + i] = out[from + i];
    seen.note_until(out, at + 1);
    at += length;
    seen.skip_to(at);
  }
  return in == end || damaged();
}

void pack_quicklz(Span<const std::uint8_t> bytes, std::vector<std::uint8_t>& to) {
  const std::size_t begin = to.size();
  const std::size_t size = bytes.size();
  const auto put_word = [&to](std::size_t at, std::uint32_t word) {
    std::memcpy(to.data() + at, &word, sizeof(word));
  };
  to.resize(begin + kLongQuickLzHeader);
  Seen seen;
  std::size_t flags_at = 0;
  std::uint32_t flags = 0;
  std::uint32_t count = 31;  // of flags in the word; 31: it is full, or there is none yet
  for (std::size_t at = 0; at < size;) {
    if (count == 31) {
      if (flags_at != 0) put_word(flags_at, flags | 0x80000000U);
      flags_at = to.size();
      to.resize(to.size() + 4);
      flags = 0;
      count = 0;
    }
    std::size_t length = 0;
    if (at + kLastMatchStart < size) {
      const std::size_t hash = hash_of(bytes.data() + at);
      const std::uint32_t from = seen.place(hash);
      const std::size_t most = std::min(kMostMatched, size - kLastMatchEnd - at);
      if (from != kNone && at - from >= kLeastDistance) {
        while (length < most && bytes[from + length] == bytes[at + length]) ++length;
      }
      if (length >= kFewestMatched) {
        const bool is_short = length < 18;
        const std::uint32_t code = static_cast<std::uint32_t>(hash << 4) |
                                   (is_short ? static_cast<std::uint32_t>(length - 2) : 0U);
        to.push_back(static_cast<std::uint8_t>(code));
        to.push_back(static_cast<std::uint8_t>(code >> 8));
        if (!is_short) to.push_back(static_cast<std::uint8_t>(length));
        seen.note_until(bytes.data(), at + 1);
        at += length;
        seen.skip_to(at);
        flags |= 1U << count++;
        continue;
      }
    }
    to.push_back(bytes[at++]);
    if (at >= 3) seen.note_until(bytes.data(), at - 2);
    ++count;
  }
  if (flags_at != 0) put_word(flags_at, flags | (1U << count));
  bool packed = true;
  if (to.size() - begin > size + kLongQuickLzHeader) {  // random bytes: stored as they are
    packed = false;
    to.resize(begin + kLongQuickLzHeader);
    to.insert(to.end(), bytes.begin(), bytes.end());
  }
  to[begin] = static_cast<std::uint8_t>(0x46U | (packed ? 1U : 0U));
  put_word(begin + 1, static_cast<std::uint32_t>(to.size() - begin));
  put_word(begin + 5, static_cast<std::uint32_t>(size));
}

}  // namespace dynslam::loop::detail
