// How a poll for Ctrl-C inside a task of a parallel loop ends the tasks of the other threads.
#pragma once

#include <atomic>

namespace substep {

// What poll_interrupt() throws in a task of a loop that another thread has ended.
struct LoopStopped {};

// While one lives, the calling thread is in the loop with this flag: its polls throw LoopStopped
// once it is true, and make it true where they throw something else.
class InLoop {
 public:
  explicit InLoop(std::atomic<bool>& stop);
  InLoop(const InLoop&) = delete;
  InLoop& operator=(const InLoop&) = delete;
  ~InLoop();
};

}  // namespace substep
