// libFuzzer target: whatever bytes come, a map is read in full and is sound, or an IoError says
// what is wrong. Checksums are made right first, or no mutation would come past them.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/slam/map_io.hpp"

#include "slam/map_check.hpp"
#include "slam/map_format.hpp"

namespace {

using namespace dynslam::slam;

void seal(std::vector<std::uint8_t>& bytes) {
  map_format::Head head;
  if (bytes.size() < sizeof(head)) return;
  std::memcpy(&head, bytes.data(), sizeof(head));
  head.checksum = dynslam::checksum(&head, offsetof(map_format::Head, checksum));
  std::memcpy(bytes.data(), &head, sizeof(head));
  map_format::SectionHead section;
  for (std::size_t at = sizeof(head); bytes.size() - at >= sizeof(section);) {
    std::memcpy(&section, bytes.data() + at, sizeof(section));
    const std::size_t content = at + sizeof(section);
    if (section.bytes > bytes.size() - content) return;
    section.checksum = dynslam::checksum(bytes.data() + content, section.bytes);
    std::memcpy(bytes.data() + at, &section, sizeof(section));
    at = content + static_cast<std::size_t>(section.bytes);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint8_t> bytes(data, data + size);
  seal(bytes);
  try {
    StoredMap stored = parse_map(bytes, "fuzz");
    if (!testing::problem_of(stored.map).empty()) std::abort();
    for (const PointId id : stored.map.point_ids()) {
      stored.map.refresh_point(id, stored.scale_factors);
    }
    // What was read is sound, so what is written of it is read again.
    const std::string written = serialize_map(stored.map, stored.camera, stored.scale_factors);
    parse_map({reinterpret_cast<const std::uint8_t*>(written.data()), written.size()}, "again");
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
