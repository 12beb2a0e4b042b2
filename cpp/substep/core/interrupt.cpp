#include "substep/core/interrupt.h"

#include <time.h>

#include <atomic>
#include <cstdint>

#include "substep/core/loop_stop.h"

namespace substep {
namespace {
constexpr std::int64_t kInterval = 20'000'000;  // [ns]
std::atomic<InterruptHook> hook{nullptr};
// With the thread, not at its first use, where a lack of memory would end the process; with one all
// of the module's are.
[[gnu::tls_model("initial-exec")]] thread_local int deferred = 0;
[[gnu::tls_model("initial-exec")]] thread_local InterruptHook poll_hook = nullptr;
[[gnu::tls_model("initial-exec")]] thread_local std::atomic<bool>* loop_stop = nullptr;
[[gnu::tls_model("initial-exec")]] thread_local std::int64_t last_look = 0;  // [ns]

// Of a clock that is read in a few nanoseconds and is exact to a few milliseconds.
std::int64_t now() {
  timespec time{};
#ifdef CLOCK_MONOTONIC_COARSE
  clock_gettime(CLOCK_MONOTONIC_COARSE, &time);
#else
  clock_gettime(CLOCK_MONOTONIC, &time);
#endif
  return std::int64_t{1'000'000'000} * time.tv_sec + time.tv_nsec;
}

void look() {
  if (poll_hook) poll_hook();
  const std::int64_t time = now();
  if (time - last_look < kInterval) return;
  last_look = time;
  if (const InterruptHook f = hook.load(std::memory_order_relaxed)) f();
}
}  // namespace

void set_interrupt_hook(InterruptHook new_hook) { hook = new_hook; }
void set_poll_hook(InterruptHook new_hook) { poll_hook = new_hook; }

void poll_interrupt() {
  if (deferred > 0) return;
  if (!loop_stop) return look();
  if (loop_stop->load(std::memory_order_relaxed)) throw LoopStopped{};
  try {
    look();
  } catch (...) {
    loop_stop->store(true, std::memory_order_relaxed);
    throw;
  }
}

InLoop::InLoop(std::atomic<bool>& stop) { loop_stop = &stop; }
InLoop::~InLoop() { loop_stop = nullptr; }

DeferInterrupts::DeferInterrupts() { ++deferred; }
DeferInterrupts::~DeferInterrupts() { --deferred; }

}  // namespace substep
