// Ctrl-C in native loops: call poll_interrupt() between phases; it throws when the user asked to
// stop. The binding installs the hook; without one (C++ programs) polling does nothing.
#pragma once

namespace substep {

using InterruptHook = void (*)();
void set_interrupt_hook(InterruptHook hook);

// For tests: the calling thread's own hook (or none), which each of its polls runs, however soon.
void set_poll_hook(InterruptHook hook);

// Cheap enough for every step (a clock read); runs the hook at most every 20 ms.
void poll_interrupt();

// While one lives, polls of its thread do nothing: for what must not end half-way, as a pass that
// changes particles in place. Keep it short.
class DeferInterrupts {
 public:
  DeferInterrupts();
  DeferInterrupts(const DeferInterrupts&) = delete;
  DeferInterrupts& operator=(const DeferInterrupts&) = delete;
  ~DeferInterrupts();
};

}  // namespace substep
