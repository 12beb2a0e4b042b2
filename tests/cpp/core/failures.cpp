#include "failures.h"

#include <cstdlib>
#include <utility>

namespace {

thread_local std::int64_t allocations = 0, polls = 0;
thread_local bool lasting = false, met = false;

}  // namespace

namespace substep::failures {

std::int64_t fail_allocation(std::int64_t n) { return std::exchange(allocations, n); }

std::int64_t fail_allocations_from(std::int64_t n) {
  lasting = n > 0;
  const std::int64_t left = std::exchange(allocations, n);
  return std::exchange(met, false) ? 0 : left;
}

std::int64_t interrupt_poll(std::int64_t n) {
  set_poll_hook(n > 0 ? [] {
    if (--polls == 0) throw Interrupt{};
  } : InterruptHook{nullptr});
  return std::exchange(polls, n);
}

}  // namespace substep::failures

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // these have their own

namespace {

void* allocate(std::size_t bytes, std::size_t alignment) {
  if (allocations > 0 && --allocations == 0) {
    if (lasting) allocations = 1, met = true;
    throw std::bad_alloc();
  }
  const std::size_t whole = (bytes + alignment - 1) / alignment * alignment;
  if (void* const memory = std::aligned_alloc(alignment, whole)) return memory;
  throw std::bad_alloc();
}

}  // namespace

void* operator new(std::size_t bytes) { return allocate(bytes, __STDCPP_DEFAULT_NEW_ALIGNMENT__); }
void* operator new(std::size_t bytes, std::align_val_t alignment) {
  return allocate(bytes, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

#endif
