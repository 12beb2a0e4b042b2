// Numbers aligned to cache lines (large ones to huge pages), uninitialised when they are made.
#pragma once

#include <cstddef>
#include <cstring>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#ifdef __linux__
#include <sys/mman.h>
#endif

namespace substep {

template <class T>
class AlignedBuffer {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  AlignedBuffer() = default;
  AlignedBuffer(AlignedBuffer&& other) noexcept { swap(other); }
  AlignedBuffer& operator=(AlignedBuffer&& other) noexcept {
    swap(other);
    return *this;
  }
  AlignedBuffer(const AlignedBuffer& other) { *this = other; }
  AlignedBuffer& operator=(const AlignedBuffer& other) {
    if (this == &other) return *this;
    reset(other.size_);
    if (size_ > 0) std::memcpy(data(), other.data(), size_ * sizeof(T));
    return *this;
  }

  // n numbers of any value: what there was is lost.
  void reset(std::size_t n) {
    if (n > capacity_) {
      memory_.reset();
      capacity_ = size_ = 0;
      const std::size_t room = n + n / 16;  // the next one may be a little larger
      const std::size_t alignment = n * sizeof(T) >= 4 * kPage ? kPage : kLine;
      const std::size_t bytes = (room * sizeof(T) + alignment - 1) / alignment * alignment;
      const std::align_val_t aligned{alignment};
      memory_ = Memory(static_cast<T*>(::operator new(bytes, aligned)), Free{aligned});
#ifdef __linux__
      if (alignment == kPage) madvise(memory_.get(), bytes, MADV_HUGEPAGE);
#endif
      capacity_ = room;
    }
    size_ = n;
  }

  T* data() { return memory_.get(); }
  const T* data() const { return memory_.get(); }
  std::size_t size() const { return size_; }
  std::size_t bytes() const { return capacity_ * sizeof(T); }
  T& operator[](std::size_t i) { return memory_.get()[i]; }
  const T& operator[](std::size_t i) const { return memory_.get()[i]; }
  T* begin() { return data(); }
  T* end() { return data() + size_; }
  const T* begin() const { return data(); }
  const T* end() const { return data() + size_; }

  void swap(AlignedBuffer& other) noexcept {
    std::swap(memory_, other.memory_);
    std::swap(size_, other.size_);
    std::swap(capacity_, other.capacity_);
  }

 private:
  static constexpr std::size_t kLine = 64, kPage = std::size_t{1} << 21;
  struct Free {
    std::align_val_t alignment{kLine};
    void operator()(T* memory) const { ::operator delete(memory, alignment); }
  };
  using Memory = std::unique_ptr<T, Free>;
  Memory memory_;
  std::size_t size_ = 0, capacity_ = 0;
};

}  // namespace substep
