// A part of a class whose header need not be seen by those who see the class: on the heap, copied
// as if it were a member. The special members of the class are then defined where the part is
// known.
#pragma once

#include <memory>

namespace substep {

template <class T>
class Held {
 public:
  Held() : part_(std::make_unique<T>()) {}
  Held(const Held& other) : part_(std::make_unique<T>(*other.part_)) {}
  Held(Held&& other) noexcept = default;
  Held& operator=(const Held& other) {
    if (part_) {
      *part_ = *other.part_;
    } else {
      part_ = std::make_unique<T>(*other.part_);
    }
    return *this;
  }
  Held& operator=(Held&& other) noexcept = default;
  ~Held() = default;

  T& operator*() { return *part_; }
  const T& operator*() const { return *part_; }
  T* operator->() { return part_.get(); }
  const T* operator->() const { return part_.get(); }

 private:
  std::unique_ptr<T> part_;  // none after a move from it
};

}  // namespace substep
