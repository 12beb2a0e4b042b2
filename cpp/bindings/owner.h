// Who uses a simulation: one thread at a time, which may call from within its calls.
#pragma once

// While one lives, its thread is in a function of the user's that a native loop calls: what this
// thread uses then is in the middle of a step, and refuses.
class InUserFunction {
 public:
  InUserFunction();
  InUserFunction(const InUserFunction&) = delete;
  InUserFunction& operator=(const InUserFunction&) = delete;
  ~InUserFunction();
};
