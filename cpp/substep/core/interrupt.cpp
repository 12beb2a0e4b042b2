#include "substep/core/interrupt.h"

#include <atomic>
#include <chrono>

#include "substep/core/loop_stop.h"

namespace substep {
namespace {
using Clock = std::chrono::steady_clock;
constexpr Clock::duration kInterval = std::chrono::milliseconds(20);
std::atomic<InterruptHook> hook{nullptr};
// With the thread, not at its first use, where a lack of memory would end the process; with it all
// of the module's are.
[[gnu::tls_model("initial-exec")]] thread_local int deferred = 0;
thread_local InterruptHook poll_hook = nullptr;
thread_local std::atomic<bool>* loop_stop = nullptr;

void look() {
  if (poll_hook) poll_hook();
  thread_local Clock::time_point last{};
  const auto now = Clock::now();
  if (now - last < kInterval) return;
  last = now;
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
