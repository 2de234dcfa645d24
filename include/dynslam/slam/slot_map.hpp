// Objects with 64-bit ids that are never given twice, in slots that are used again.
#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <utility>
#include <vector>

namespace dynslam::slam {

/// Id of nothing.
inline constexpr std::uint64_t kNoId = ~std::uint64_t{0};

/// Where the object of an id lies: alone there among the living, and below the number of slots, so
/// that an array can hold a value for each object.
inline std::uint32_t slot_of(std::uint64_t id) { return static_cast<std::uint32_t>(id); }

/// Owns objects of type T; an id is its slot and how often the slot was used before.
///
/// Looking up, inserting and erasing are O(1); an id of an erased object finds nothing, ever.
/// Objects stay where they are in memory until erased. Memory is that of the most objects alive at
/// once. Iteration is in slot order, hence the same in every run. Not thread-safe.
template <typename T>
class SlotMap {
 public:
  /// Constructs an object in place; its id is returned.
  template <typename... Arguments>
  std::uint64_t emplace(Arguments&&... arguments) {
    std::uint32_t slot;
    if (free_.empty()) {
      slot = static_cast<std::uint32_t>(slots_.size());
      slots_.emplace_back();
    } else {
      slot = free_.back();
      free_.pop_back();
    }
    slots_[slot].value = T{std::forward<Arguments>(arguments)...};
    slots_[slot].alive = true;
    ++size_;
    return id_of(slot);
  }

  /// The object, or nullptr if the id is unknown or its object was erased.
  T* find(std::uint64_t id) { return const_cast<T*>(std::as_const(*this).find(id)); }
  const T* find(std::uint64_t id) const {
    const std::uint32_t slot = slot_of(id);
    if (id == kNoId || slot >= slots_.size()) return nullptr;
    const Slot& entry = slots_[slot];
    return entry.alive && entry.generation == id >> 32U ? &entry.value : nullptr;
  }
  bool contains(std::uint64_t id) const { return find(id) != nullptr; }

  /// The object, which must be there.
  T& at(std::uint64_t id) {
    T* object = find(id);
    assert(object != nullptr);
    return *object;
  }
  const T& at(std::uint64_t id) const {
    const T* object = find(id);
    assert(object != nullptr);
    return *object;
  }

  /// Erases the object; false if there is none.
  bool erase(std::uint64_t id) {
    if (!contains(id)) return false;
    const std::uint32_t slot = slot_of(id);
    slots_[slot].value = T{};
    slots_[slot].alive = false;
    ++slots_[slot].generation;
    free_.push_back(slot);
    --size_;
    return true;
  }

  std::size_t size() const { return size_; }
  bool empty() const { return size_ == 0; }

  /// Calls visit(id, object) for every object, in slot order.
  template <typename Visitor>
  void for_each(Visitor&& visit) const {
    for (std::uint32_t slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].alive) visit(id_of(slot), slots_[slot].value);
    }
  }
  template <typename Visitor>
  void for_each(Visitor&& visit) {
    for (std::uint32_t slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].alive) visit(id_of(slot), slots_[slot].value);
    }
  }

 private:
  struct Slot {
    T value{};
    std::uint64_t generation = 0;
    bool alive = false;
  };
  std::uint64_t id_of(std::uint32_t slot) const { return slots_[slot].generation << 32U | slot; }

  std::deque<Slot> slots_;
  std::vector<std::uint32_t> free_;
  std::size_t size_ = 0;
};

}  // namespace dynslam::slam
