// Views of arrays that somebody else owns.
//
// `Span` is our own type in every language mode (never an alias of std::span),
// so that a compiled library and its user agree on the type whatever standard
// each is built with.
#pragma once

#include <cassert>
#include <cstddef>
#include <iterator>
#include <type_traits>
#include <utility>

namespace dynslam {

/// View of `size` contiguous elements. Trivially copyable; pass by value; never
/// outlives its array.
template <typename T>
class Span {
 public:
  using element_type = T;
  using value_type = std::remove_cv_t<T>;
  using iterator = T*;

  constexpr Span() = default;
  constexpr Span(T* data, std::size_t size) : data_(data), size_(size) {}

  template <std::size_t N>
  constexpr Span(T (&array)[N]) : data_(array), size_(N) {}

  /// Binds any contiguous container with data() and size() (std::vector,
  /// std::array, Span) without a copy. A temporary container binds only to a
  /// Span of const, as a function argument does.
  template <typename Container, typename Pointer = decltype(std::declval<Container&>().data()),
            typename = decltype(std::declval<Container&>().size()),
            typename = std::enable_if_t<
                std::is_convertible_v<std::remove_pointer_t<Pointer> (*)[], T (*)[]> &&
                (std::is_lvalue_reference_v<Container> || std::is_const_v<T>)>>
  constexpr Span(Container&& container) : data_(container.data()), size_(container.size()) {}

  constexpr T* data() const { return data_; }
  constexpr std::size_t size() const { return size_; }
  constexpr bool empty() const { return size_ == 0; }
  constexpr T* begin() const { return data_; }
  constexpr T* end() const { return data_ + size_; }

  constexpr T& operator[](std::size_t i) const {
    assert(i < size_);
    return data_[i];
  }

  /// Elements [offset, offset + count); the caller guarantees that they exist.
  constexpr Span subspan(std::size_t offset, std::size_t count) const {
    assert(offset + count <= size_);
    return Span(data_ + offset, count);
  }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
};

template <typename Container>
Span(Container&) -> Span<std::remove_pointer_t<decltype(std::declval<Container&>().data())>>;

/// View of `size` elements that lie `stride` bytes apart, such as one member of
/// an array of structs.
template <typename T>
class StridedSpan {
 public:
  using element_type = T;
  using value_type = std::remove_cv_t<T>;
  using Byte = std::conditional_t<std::is_const_v<T>, const char, char>;

  class iterator {
   public:
    using iterator_category = std::forward_iterator_tag;
    using value_type = std::remove_cv_t<T>;
    using difference_type = std::ptrdiff_t;
    using pointer = T*;
    using reference = T&;

    iterator() = default;
    iterator(Byte* at, std::ptrdiff_t stride) : at_(at), stride_(stride) {}
    T& operator*() const { return *reinterpret_cast<T*>(at_); }
    T* operator->() const { return reinterpret_cast<T*>(at_); }
    iterator& operator++() {
      at_ += stride_;
      return *this;
    }
    iterator operator++(int) {
      iterator before = *this;
      ++*this;
      return before;
    }
    friend bool operator==(iterator a, iterator b) { return a.at_ == b.at_; }
    friend bool operator!=(iterator a, iterator b) { return a.at_ != b.at_; }

   private:
    Byte* at_ = nullptr;
    std::ptrdiff_t stride_ = 0;
  };

  constexpr StridedSpan() = default;
  constexpr StridedSpan(T* data, std::size_t size, std::ptrdiff_t stride_bytes = sizeof(T))
      : data_(data), size_(size), stride_(stride_bytes) {}
  constexpr StridedSpan(Span<T> span) : StridedSpan(span.data(), span.size()) {}

  /// Binds any contiguous container (see Span).
  template <typename Container,
            typename = std::enable_if_t<std::is_constructible_v<Span<T>, Container&> &&
                                        !std::is_same_v<std::decay_t<Container>, Span<T>>>>
  constexpr StridedSpan(Container& container) : StridedSpan(Span<T>(container)) {}

  /// A view of mutable elements reads as a view of const ones.
  template <typename U,
            typename = std::enable_if_t<std::is_same_v<const U, T> && !std::is_const_v<U>>>
  constexpr StridedSpan(StridedSpan<U> other)
      : StridedSpan(other.data(), other.size(), other.stride_bytes()) {}

  constexpr T* data() const { return data_; }
  constexpr std::size_t size() const { return size_; }
  constexpr std::ptrdiff_t stride_bytes() const { return stride_; }
  constexpr bool empty() const { return size_ == 0; }

  T& operator[](std::size_t i) const {
    assert(i < size_);
    return *reinterpret_cast<T*>(reinterpret_cast<Byte*>(data_) +
                                 static_cast<std::ptrdiff_t>(i) * stride_);
  }
  iterator begin() const { return {reinterpret_cast<Byte*>(data_), stride_}; }
  iterator end() const {
    return {reinterpret_cast<Byte*>(data_) + static_cast<std::ptrdiff_t>(size_) * stride_, stride_};
  }

 private:
  T* data_ = nullptr;
  std::size_t size_ = 0;
  std::ptrdiff_t stride_ = sizeof(T);
};

/// View of one member of every struct in an array: `field(keypoints,
/// &cv::KeyPoint::pt)`.
///
/// No copy: element i of the result is the member of struct i itself. O(1).
template <typename Container, typename Member, typename Struct>
auto field(Container& structs, Member Struct::*member) {
  Span span(structs);
  using Element = std::remove_pointer_t<decltype(span.data())>;
  using Result = std::conditional_t<std::is_const_v<Element>, const Member, Member>;
  Result* first = span.empty() ? nullptr : &(span.data()->*member);
  return StridedSpan<Result>(first, span.size(), sizeof(Element));
}

}  // namespace dynslam
