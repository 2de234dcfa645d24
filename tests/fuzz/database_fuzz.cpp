// libFuzzer target: whatever bytes come, the database is read in full and works, or an IoError says
// what is wrong. Checksums are made right first, or no mutation would come past them.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/loop/database.hpp"

namespace {

using dynslam::checksum;

void seal(std::vector<std::uint8_t>& bytes) {
  if (bytes.size() < 48) return;
  std::uint64_t sum = checksum(bytes.data(), 40), images = 0;
  std::memcpy(bytes.data() + 40, &sum, 8);
  std::memcpy(&images, bytes.data() + 24, 8);
  if (images > bytes.size() / 12) return;
  std::size_t at = 48 + 12 * images;
  if (at + 8 > bytes.size()) return;
  sum =
      checksum(bytes.data() + 48 + 8 * images, 4 * images, checksum(bytes.data() + 48, 8 * images));
  std::memcpy(bytes.data() + at, &sum, 8);
  at += 8;
  while (at + 8 <= bytes.size()) {
    std::uint32_t size = 0;
    std::memcpy(&size, bytes.data() + at, 4);
    if (size > bytes.size() - at - 8) return;
    const auto page = static_cast<std::uint32_t>(checksum(bytes.data() + at + 8, size));
    std::memcpy(bytes.data() + at + 4, &page, 4);
    at += 8 + size;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace dynslam::loop;
  std::vector<std::uint8_t> bytes(data, data + size);
  seal(bytes);
  try {
    Database database = Database::deserialize(bytes);
    BowVector bow;
    for (WordId word = 0; word < 70 && word < database.words(); ++word) bow.push_back(word, 0.01);
    for (const std::size_t k : {0U, 1U, 5U}) {
      QueryOptions options;
      options.max_results = k;
      if (database.query(bow, options).size() > database.size()) std::abort();
    }
    std::uint64_t id = 1;
    while (database.contains(id)) ++id;
    database.add(id, bow);
    if (database.serialize().empty() || !database.remove(id)) std::abort();
    database.compact();
    // What was read is sound, so what is written of it is read again.
    const std::vector<std::uint8_t> written = database.serialize();
    if (Database::deserialize(written).serialize() != written) std::abort();
  } catch (const dynslam::IoError&) {
  }
  return 0;
}
