// What may happen to particles on a grid.
#pragma once

#include <cstdint>

namespace substep::fields {

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

}  // namespace substep::fields
