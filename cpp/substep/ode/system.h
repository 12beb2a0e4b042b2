// What an integrator sees of a problem: y' = f(t, y), and where it has the form x'' = a(t, x, v)
// also the acceleration, with y = [x, v].
#pragma once

#include <cstdint>
#include <string_view>

#include "substep/core/errors.h"

namespace substep::ode {

// `steps` equal steps h of a method, from t and y on; y is overwritten.
struct FixedRun {
  std::string_view method;
  double t;
  double h;
  std::int64_t steps;
  double* y;
  int threads;  // 0: default
};

class System {
 public:
  System() = default;
  System(const System&) = delete;
  System& operator=(const System&) = delete;
  virtual ~System() = default;

  virtual std::int64_t size() const = 0;
  virtual void rhs(double t, const double* y, double* dydt) = 0;

  // True where rhs needs no interpreter and may be called from several threads at once.
  virtual bool native() const { return true; }

  // x'' = a(t, x, v) with d = size() / 2 components, for systems that say so.
  virtual bool second_order() const { return false; }
  virtual void acceleration(double /*t*/, const double* /*x*/, const double* /*v*/, double* /*a*/) {
    throw InputError("this system is not of second order");
  }

  // Runs the steps with a kernel of the system's own (force and stages fused) and returns true, or
  // returns false and leaves y alone.
  virtual bool fixed_steps(const FixedRun& /*run*/) { return false; }
};

}  // namespace substep::ode
