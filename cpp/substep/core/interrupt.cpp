#include "substep/core/interrupt.h"

#include <atomic>
#include <chrono>

namespace substep {
namespace {
using Clock = std::chrono::steady_clock;
constexpr Clock::duration kInterval = std::chrono::milliseconds(20);
std::atomic<InterruptHook> hook{nullptr};
}  // namespace

void set_interrupt_hook(InterruptHook new_hook) { hook = new_hook; }

void poll_interrupt() {
  thread_local Clock::time_point last{};
  const auto now = Clock::now();
  if (now - last < kInterval) return;
  last = now;
  if (const InterruptHook f = hook.load(std::memory_order_relaxed)) f();
}

}  // namespace substep
