#include "substep/core/interrupt.h"

#include <atomic>
#include <chrono>

namespace substep {
namespace {
using Clock = std::chrono::steady_clock;
constexpr Clock::duration kInterval = std::chrono::milliseconds(20);
std::atomic<InterruptHook> hook{nullptr};
thread_local int deferred = 0;
thread_local InterruptHook poll_hook = nullptr;
}  // namespace

void set_interrupt_hook(InterruptHook new_hook) { hook = new_hook; }
void set_poll_hook(InterruptHook new_hook) { poll_hook = new_hook; }

void poll_interrupt() {
  if (deferred > 0) return;
  if (poll_hook) poll_hook();
  thread_local Clock::time_point last{};
  const auto now = Clock::now();
  if (now - last < kInterval) return;
  last = now;
  if (const InterruptHook f = hook.load(std::memory_order_relaxed)) f();
}

DeferInterrupts::DeferInterrupts() { ++deferred; }
DeferInterrupts::~DeferInterrupts() { --deferred; }

}  // namespace substep
