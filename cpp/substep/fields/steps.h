// Which steps particles take, by which method, and what may happen to them.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace substep::fields {

// Time after n steps, the same bits however the steps are grouped into calls.
struct Steps {
  double origin, h;    // [s]; h < 0 goes back in time
  std::int64_t first;  // number of the first step since `origin`
  std::int64_t count;
  double time(std::int64_t step) const { return origin + static_cast<double>(first + step) * h; }
};

// The first step, and in it the first particle, at which something happened; step -1: nothing.
struct Event {
  std::int64_t step = -1, particle = -1;
  void note(std::int64_t at_step, std::int64_t at_particle) {
    if (step < 0 || at_step < step || (at_step == step && at_particle < particle)) {
      step = at_step;
      particle = at_particle;
    }
  }
  void note(const Event& other) {
    if (other.step >= 0) note(other.step, other.particle);
  }
};
struct Events {
  Event landed, escaped, not_finite;
};

// The table of a method (methods.h), for callables of the user.
struct MethodTable {
  std::string name;
  std::vector<std::vector<double>> a;
  std::vector<double> b, c;
  double divisor;
};
std::vector<MethodTable> method_tables();

}  // namespace substep::fields
