// What may come between, at a place that is counted: no memory, an interrupt.
#pragma once

#include <cstdint>
#include <new>
#include <string>
#include <utility>
#include <variant>

#include "substep/core/interrupt.h"

namespace substep::failures {

struct Interrupt {};

// The n-th allocation by `new` of this thread from now on fails, once; 0: none does. Returns how
// many were left of those of the last call.
std::int64_t fail_allocation(std::int64_t n);
// The n-th and all that follow.
std::int64_t fail_allocations_from(std::int64_t n);
// The n-th poll of this thread from now on throws Interrupt.
std::int64_t interrupt_poll(std::int64_t n);

// What a state is made of, to be compared bit for bit.
class Bytes {
 public:
  template <class T>
  void put(const T* values, std::size_t n) {
    bytes_.append(reinterpret_cast<const char*>(values), n * sizeof *values);
  }
  template <class... Lists>
  void put_all(const Lists&... lists) {
    (put(lists.data(), lists.size()), ...);
  }
  template <class... Variants>
  void put_each(const Variants&... variants) {
    (std::visit([&](const auto& list) { put_all(list); }, variants), ...);
  }
  std::string take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

// trial(call) makes an object, passes what it does with it to call, and looks at what is left: once
// for each place at which call can fail. Returns how many those are.
template <class Trial>
std::int64_t at_each(std::int64_t (*fail)(std::int64_t), const Trial& trial) {
  bool met = true;
  std::int64_t n = 0;
  while (met) {
    ++n;
    trial([&](const auto& work) {
      fail(n);
      try {
        work();
      } catch (const std::bad_alloc&) {
      } catch (const Interrupt&) {
      }
      met = fail(0) == 0;
    });
  }
  return n - 1;
}

}  // namespace substep::failures
