// Packets of QuickLZ level 1 without a streaming buffer, as DBoW3 writes them.
//
// A packet: flags (bit 0 packed, bit 1 long sizes, bits 2-3 level, bit 6 set), its size with the
// header, the size that it unpacks to (both of 4 bytes, or of 1 without bit 1), content. Packed
// content is words of 31 flags, each before what it describes, low bit first, a set bit above the
// last: 0 is a literal byte, 1 a match. A match is 2 bytes: length - 2 in the low 4 bits and a
// hash of 12 bits above; with length bits 0 a third byte holds the length. A hash of the three
// bytes at a place leads to the last place where it was seen; places within matches are not noted
// but for their first.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "dynslam/core/span.hpp"

namespace dynslam::loop::detail {

inline constexpr std::size_t kLongQuickLzHeader = 9;

struct QuickLzHeader {
  bool packed = false;
  std::size_t header_bytes = 0;
  std::uint32_t packet_bytes = 0;  // with the header
  std::uint32_t unpacked_bytes = 0;
};

/// Reads the first bytes of a packet (kLongQuickLzHeader of them); nothing if they are no header of
/// the kind above.
std::optional<QuickLzHeader> read_quicklz_header(Span<const std::uint8_t> bytes);

/// Appends what a whole packet unpacks to; false, and `to` is as before, if it is damaged.
bool unpack_quicklz(Span<const std::uint8_t> packet, std::vector<std::uint8_t>& to);

/// Appends a packet that unpacks to `bytes`.
void pack_quicklz(Span<const std::uint8_t> bytes, std::vector<std::uint8_t>& to);

}  // namespace dynslam::loop::detail
