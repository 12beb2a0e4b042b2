// What a batch knows of a simulation of any method (batch.h).
#pragma once

#include <cstdint>
#include <vector>

namespace substep {

class Simulation {
 public:
  virtual ~Simulation() = default;

  // One step of dt [s], or an exception and nothing has changed.
  virtual void step(double dt) = 0;
  virtual double time() const = 0;  // [s]
  virtual void set_time(double time) = 0;

  // Keeps the present state, that of the obstacles too, and goes back to it, once, from what
  // steps alone have made of it.
  virtual void keep() = 0;
  virtual void rewind() = 0;

  // Of a method that chooses the sizes of its steps and fuses them: a step, and all until `end`
  // [s], of which a failure leaves the state after the last good one. The same one by one: the
  // first of them says so.
  virtual void step_by_limit() {}
  virtual void advance(double /*end*/) {}
  virtual void advance_once(double /*end*/, bool /*first*/) {}

  // Rows of so many numbers, of each particle.
  virtual int columns() const { return 3; }
  virtual std::vector<double> positions() const = 0;   // [m]
  virtual std::vector<double> velocities() const = 0;  // [m/s]
};

}  // namespace substep
