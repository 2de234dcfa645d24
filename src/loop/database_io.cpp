// The file of a database:
//
//   head    magic "dynsBOWi", u32 version, u32 byte order mark, u64 words, u64 images,
//           u32 scoring, u32 0, u64 checksum of the head before it
//   images  u64 ids[images], f32 scales[images], u64 checksum of both
//   pages   for every 64 words: u32 bytes, u32 checksum, then the page (posting_page.hpp)
//
// and nothing after it. All little endian.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>

#include "dynslam/core/checksum.hpp"
#include "dynslam/core/errors.hpp"
#include "dynslam/core/files.hpp"
#include "dynslam/loop/database.hpp"

#include "database_state.hpp"

namespace dynslam::loop {
namespace {

constexpr char kMagic[8] = {'d', 'y', 'n', 's', 'B', 'O', 'W', 'i'};
constexpr std::uint32_t kVersion = 1, kByteOrder = 0x01020304;

struct Head {
  char magic[8];
  std::uint32_t version, byte_order;
  std::uint64_t words, images;
  std::uint32_t scoring, reserved;
  std::uint64_t checksum;
};
static_assert(sizeof(Head) == 48, "the head has no gaps");

struct PageHead {
  std::uint32_t bytes, checksum;
};

std::uint64_t head_checksum(const Head& head) { return checksum(&head, offsetof(Head, checksum)); }

struct MemorySink {
  std::vector<std::uint8_t> bytes;
  void write(const void* data, std::size_t size) {
    const auto* first = static_cast<const std::uint8_t*>(data);
    bytes.insert(bytes.end(), first, first + size);
  }
};

/// Bytes in order, never more than there are.
class FileSource {
 public:
  explicit FileSource(const std::string& path) : name(path), file_(std::fopen(path.c_str(), "rb")) {
    long size = -1;
    if (file_ != nullptr && std::fseek(file_, 0, SEEK_END) == 0) size = std::ftell(file_);
    if (size < 0 || std::fseek(file_, 0, SEEK_SET) != 0) {
      if (file_ != nullptr) std::fclose(file_);
      throw_io_error(path, "cannot be read");
    }
    remaining = static_cast<std::uint64_t>(size);
  }
  ~FileSource() { std::fclose(file_); }
  FileSource(const FileSource&) = delete;
  FileSource& operator=(const FileSource&) = delete;
  void read(void* into, std::size_t bytes) {
    if (bytes > 0 && std::fread(into, 1, bytes, file_) != bytes)
      throw_io_error(name, "cannot be read");
    remaining -= bytes;
  }
  std::uint64_t remaining = 0;
  const std::string name;

 private:
  std::FILE* file_;
};

struct MemorySource {
  MemorySource(Span<const std::uint8_t> bytes, const std::string& name_)
      : remaining(bytes.size()), name(name_), at_(bytes.data()) {}
  void read(void* into, std::size_t bytes) {
    if (bytes > 0) std::memcpy(into, at_, bytes);
    at_ += bytes;
    remaining -= bytes;
  }
  std::uint64_t remaining;
  const std::string& name;

 private:
  const std::uint8_t* at_;
};

template <typename Sink>
void write_page(const PostingPage& page, Sink& sink) {
  const Span<const std::uint8_t> bytes = page.bytes();
  PageHead head;
  head.bytes = static_cast<std::uint32_t>(bytes.size());
  head.checksum = static_cast<std::uint32_t>(checksum(bytes.data(), bytes.size()));
  sink.write(&head, sizeof(head));
  sink.write(bytes.data(), bytes.size());
}

template <typename Source>
[[noreturn]] void refuse(const Source& source, const std::string& what) {
  throw_io_error(source.name, "no sound database: " + what);
}

template <typename Source>
Head read_head(Source& source) {
  if (source.remaining < sizeof(Head)) refuse(source, "shorter than its head");
  Head head;
  source.read(&head, sizeof(head));
  if (std::memcmp(head.magic, kMagic, sizeof(kMagic)) != 0)
    refuse(source, "it does not start with \"dynsBOWi\"");
  if (head.byte_order != kByteOrder) refuse(source, "the byte order is another machine's");
  if (head.version != kVersion) {
    refuse(source, "version " + std::to_string(head.version) + ", this library reads version " +
                       std::to_string(kVersion));
  }
  if (head.checksum != head_checksum(head)) refuse(source, "the head's checksum is wrong");
  if (head.words < 1 || head.words > 0xFFFFFFFFULL)
    refuse(source, std::to_string(head.words) + " words");
  if (head.scoring > static_cast<std::uint32_t>(Scoring::kDotProduct))
    refuse(source, "scoring " + std::to_string(head.scoring));
  if (head.reserved != 0) refuse(source, "a reserved field is not 0");
  const std::uint64_t pages = (head.words + PostingPage::kWords - 1) / PostingPage::kWords;
  if (head.images > 0xFFFFFFFEULL || source.remaining < 12 * head.images + 8 + 8 * pages) {
    refuse(source, std::to_string(head.images) + " images and " + std::to_string(head.words) +
                       " words do not fit into the file");
  }
  return head;
}

template <typename Source, typename State>
void read_images(Source& source, State& state, std::size_t images) {
  state.ids.resize(images);
  state.scales.resize(images);
  source.read(state.ids.data(), 8 * images);
  source.read(state.scales.data(), 4 * images);
  std::uint64_t sum;
  source.read(&sum, sizeof(sum));
  if (sum != checksum(state.scales.data(), 4 * images, checksum(state.ids.data(), 8 * images)))
    refuse(source, "the checksum of the images is wrong");
  state.dead.assign(images, 0);
  state.slot_of.reserve(images);
  for (std::size_t slot = 0; slot < images; ++slot) {
    const float scale = state.scales[slot];
    if (!std::isfinite(scale) || scale < 0.0F)
      refuse(source, "the scale of image " + std::to_string(slot) + " is not a number >= 0");
    if (!state.slot_of.emplace(state.ids[slot], static_cast<std::uint32_t>(slot)).second)
      refuse(source, "the id " + std::to_string(state.ids[slot]) + " occurs twice");
    state.greatest_scale = std::max(state.greatest_scale, scale);
  }
}

template <typename Source, typename State>
void read_pages(Source& source, State& state) {
  std::vector<std::uint8_t> bytes;
  for (std::size_t p = 0; p < state.pages.size(); ++p) {
    const std::string where = "page " + std::to_string(p) + ": ";
    PageHead head;
    if (source.remaining < sizeof(head)) refuse(source, where + "missing");
    source.read(&head, sizeof(head));
    if (head.bytes > source.remaining) refuse(source, where + "cut off");
    bytes.resize(head.bytes);
    source.read(bytes.data(), bytes.size());
    if (head.checksum != static_cast<std::uint32_t>(checksum(bytes.data(), bytes.size())))
      refuse(source, where + "the checksum is wrong");
    const bool last = p + 1 == state.pages.size();
    const std::size_t words =
        last ? state.words - p * PostingPage::kWords : std::size_t{PostingPage::kWords};
    const std::string wrong =
        state.pages[p].assign(bytes, static_cast<std::uint32_t>(state.ids.size()));
    if (!wrong.empty()) refuse(source, where + wrong);
    for (std::size_t w = words; w < PostingPage::kWords; ++w) {
      if (state.pages[p].list(static_cast<std::uint32_t>(w)).bytes > 0)
        refuse(source, where + "a word beyond the last one has images");
    }
  }
  if (source.remaining > 0)
    refuse(source, std::to_string(source.remaining) + " bytes after its end");
}

}  // namespace

template <typename Sink>
void Database::State::write(Sink& sink) const {
  const std::vector<std::uint32_t> moved = slots_without_dead();
  std::vector<std::uint64_t> live_ids;
  std::vector<float> live_scales;
  for (std::size_t slot = 0; slot < ids.size(); ++slot) {
    if (dead[slot] != 0) continue;
    live_ids.push_back(ids[slot]);
    live_scales.push_back(scales[slot]);
  }
  Head head = {};
  std::memcpy(head.magic, kMagic, sizeof(kMagic));
  head.version = kVersion;
  head.byte_order = kByteOrder;
  head.words = words;
  head.images = live_ids.size();
  head.scoring = static_cast<std::uint32_t>(scoring);
  head.checksum = head_checksum(head);
  const std::uint64_t sum = checksum(live_scales.data(), 4 * live_scales.size(),
                                     checksum(live_ids.data(), 8 * live_ids.size()));
  sink.write(&head, sizeof(head));
  sink.write(live_ids.data(), 8 * live_ids.size());
  sink.write(live_scales.data(), 4 * live_scales.size());
  sink.write(&sum, sizeof(sum));
  for (const PostingPage& page : pages) {
    if (dead_count == 0) {
      write_page(page, sink);
    } else {
      write_page(without_dead(page, moved), sink);
    }
  }
}

template <typename Source>
std::unique_ptr<Database::State> Database::State::read(Source& source) {
  const Head head = read_head(source);
  auto state = std::make_unique<State>(head.words, static_cast<Scoring>(head.scoring));
  read_images(source, *state, head.images);
  read_pages(source, *state);
  return state;
}

void Database::save(const std::string& path) const {
  AtomicFile file(path);
  {
    const ReaderLock lock(state_->gate, state_->guard);
    state_->write(file);
  }
  file.commit();
}

std::vector<std::uint8_t> Database::serialize() const {
  MemorySink sink;
  const ReaderLock lock(state_->gate, state_->guard);
  state_->write(sink);
  return std::move(sink.bytes);
}

Database Database::load(const std::string& path) {
  FileSource source(path);
  return Database(State::read(source));
}

Database Database::deserialize(Span<const std::uint8_t> bytes, const std::string& name) {
  MemorySource source(bytes, name);
  return Database(State::read(source));
}

}  // namespace dynslam::loop
