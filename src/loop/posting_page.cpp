#include "posting_page.hpp"

#include <algorithm>
#include <cassert>
#include <cstdlib>
#include <new>

namespace dynslam::loop {
namespace {

// Bytes beyond the first that a distance needs.
std::uint32_t extra_bytes(std::uint32_t distance) {
  return distance < (1U << 8) ? 0U : distance < (1U << 16) ? 1U : distance < (1U << 24) ? 2U : 3U;
}

// Why a list of a file cannot be one, or nothing.
std::string check_list(PostingPage::List list, std::uint32_t last, std::uint32_t slots) {
  std::uint32_t previous = 0;
  bool any = false;
  while (list.bytes > 0) {
    const std::uint32_t bytes = std::min(list.bytes, PostingPage::kBlockBytes);
    std::uint32_t at = 0;
    bool first = true;
    while (bytes - at >= 3) {
      std::uint16_t head;
      std::memcpy(&head, list.begin + at, 2);
      if (head == 0) break;
      const std::uint32_t size = (head & 3U) + 3U, code = head >> 2;
      if (size > bytes - at) return "a posting is cut off";
      if (code < kLeastCode || code > kGreatestCode) return "a weight is out of bounds";
      std::uint32_t distance = 0;
      std::memcpy(&distance, list.begin + at + 2, size - 2);
      const std::uint64_t slot = first ? distance : std::uint64_t{previous} + distance;
      if (any && slot <= previous) return "a list is not ascending";
      if (slot >= slots) return "a list names an image that does not exist";
      previous = static_cast<std::uint32_t>(slot);
      any = true;
      first = false;
      at += size;
    }
    if (first) return "a block of a list is empty";
    if (list.bytes <= PostingPage::kBlockBytes && at != bytes)
      return "a list ends in the middle of a posting";
    for (; at < bytes; ++at) {
      if (list.begin[at] != 0) return "padding is not 0";
    }
    list.begin += bytes;
    list.bytes -= bytes;
  }
  if (any && previous != last) return "a list does not end with its last image";
  return {};
}

}  // namespace

std::uint32_t encode_ratio(float ratio) {
  // Below the least code, and NaN, which the caller does not let in.
  if (!(ratio > 0x1p-14F)) return kLeastCode;
  if (ratio >= 1.0F) return kGreatestCode;
  std::uint32_t bits;
  std::memcpy(&bits, &ratio, sizeof(bits));
  return std::min((bits - (112U << 23) + (1U << 12)) >> 13, kGreatestCode);
}

void PostingPage::Free::operator()(std::uint8_t* memory) const { std::free(memory); }

std::size_t PostingPage::allocated() const {
  return memory_ == nullptr ? 0 : sizeof(Prefix) + sizeof(Table) + prefix().capacity + kPadding;
}

void PostingPage::grow(std::uint32_t payload_bytes, bool slack) {
  const std::uint32_t capacity = slack ? payload_bytes + payload_bytes / 16 + 16 : payload_bytes;
  const bool fresh = memory_ == nullptr;
  void* memory = std::realloc(memory_.get(), sizeof(Prefix) + sizeof(Table) + capacity + kPadding);
  if (memory == nullptr) throw std::bad_alloc();
  static_cast<void>(memory_.release());
  memory_.reset(static_cast<std::uint8_t*>(memory));
  prefix().capacity = capacity;
  if (fresh) std::memset(&header(), 0, sizeof(Table));
}

void PostingPage::append(std::uint32_t word, std::uint32_t slot, std::uint32_t code) {
  assert(word < kWords && code >= kLeastCode && code <= kGreatestCode);
  if (memory_ == nullptr) grow(0, true);
  const std::uint32_t begin = word == 0 ? 0 : header().end[word - 1];
  const std::uint32_t bytes = header().end[word] - begin;
  std::uint32_t in_block = bytes % kBlockBytes;
  std::uint32_t distance = in_block == 0 ? slot : slot - header().last[word];
  std::uint32_t extra = extra_bytes(distance), padding = 0;
  if (in_block != 0 && in_block + 3 + extra > kBlockBytes) {
    padding = kBlockBytes - in_block;
    distance = slot;
    extra = extra_bytes(distance);
  }
  const std::uint32_t added = padding + 3 + extra, total = header().end[kWords - 1];
  if (total > 0xFFFFFFFFU - added - total / 8 - 64) throw std::bad_alloc();
  if (total + added > prefix().capacity) grow(total + added, true);

  std::uint8_t* const at = payload() + begin + bytes;
  std::memmove(at + added, at, total - begin - bytes);
  std::memset(at, 0, padding);
  const auto head = static_cast<std::uint16_t>(code << 2 | extra);
  std::memcpy(at + padding, &head, 2);
  std::memcpy(at + padding + 2, &distance, 1 + extra);
  for (std::uint32_t w = word; w < kWords; ++w) header().end[w] += added;
  header().last[word] = slot;
}

Span<const std::uint8_t> PostingPage::bytes() const {
  if (memory_ == nullptr) return {};
  return {memory_.get() + sizeof(Prefix), sizeof(Table) + header().end[kWords - 1]};
}

std::string PostingPage::assign(Span<const std::uint8_t> bytes, std::uint32_t slots) {
  if (bytes.empty()) {
    memory_.reset();
    return {};
  }
  if (bytes.size() < sizeof(Table)) return "a page is shorter than its table";
  Table table;
  std::memcpy(&table, bytes.data(), sizeof(Table));
  for (std::uint32_t w = 1; w < kWords; ++w) {
    if (table.end[w] < table.end[w - 1]) return "a list ends before it begins";
  }
  if (table.end[kWords - 1] != bytes.size() - sizeof(Table))
    return "the lists do not fill their page";
  PostingPage page;
  page.grow(table.end[kWords - 1], false);
  page.header() = table;
  std::memcpy(page.payload(), bytes.data() + sizeof(Table), table.end[kWords - 1]);
  std::memset(page.payload() + table.end[kWords - 1], 0, kPadding);
  for (std::uint32_t w = 0; w < kWords; ++w) {
    std::string wrong = check_list(page.list(w), table.last[w], slots);
    if (!wrong.empty()) return wrong;
  }
  *this = std::move(page);
  return {};
}

}  // namespace dynslam::loop
