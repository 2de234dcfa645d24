// The file of a map:
//
//   head      magic "dynsMAPf", u32 version, u32 byte order mark, u64 keyframes, u64 checksum of
//             the head before it
//   sections  camera, each keyframe in the order they were made, points; each of them u32 tag,
//             u32 0, u64 bytes, u64 checksum, then the bytes
//
// and nothing after it. All little endian. What is in a section is told by its writer.
#pragma once

#include <cstdint>

namespace dynslam::slam::map_format {

inline constexpr char kMagic[8] = {'d', 'y', 'n', 's', 'M', 'A', 'P', 'f'};
inline constexpr std::uint32_t kVersion = 1;
inline constexpr std::uint32_t kByteOrder = 0x01020304;
inline constexpr int kDescriptorBytes = 32;

enum class Tag : std::uint32_t { kCamera = 1, kKeyframe = 2, kPoints = 3 };

struct Head {
  char magic[8];
  std::uint32_t version, byte_order;
  std::uint64_t keyframes;
  std::uint64_t checksum;
};
static_assert(sizeof(Head) == 32, "the head has no gaps");

struct SectionHead {
  std::uint32_t tag, reserved;
  std::uint64_t bytes;
  std::uint64_t checksum;
};
static_assert(sizeof(SectionHead) == 24, "a section's head has no gaps");

// Bytes of the smallest feature, point and observation: a count that needs more than there are is
// refused before anything is allocated.
inline constexpr std::size_t kFeatureBytes = 6 * 4 + 2 * 4 + 4 + kDescriptorBytes;
inline constexpr std::size_t kPointBytes = 3 * 8 + 6 * 4 + 2 * 4 + 8 + 3 + kDescriptorBytes + 4;
inline constexpr std::size_t kObservationBytes = 8;

}  // namespace dynslam::slam::map_format
