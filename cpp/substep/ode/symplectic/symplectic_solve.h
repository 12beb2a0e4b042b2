// From an initial value to the requested outputs with the methods of symplectic.h.
#pragma once

#include <functional>
#include <limits>
#include <string>

#include "substep/ode/symplectic/symplectic.h"

namespace substep::ode {

struct SecondOrderProblem {
  int method;
  double t0, t1, step;
  const double* x0;
  const double* v0;
  bool every_step;                 // output at t0 and after every step, else at t_eval
  std::span<const double> t_eval;  // from t0 towards t1
  std::int64_t max_steps = std::numeric_limits<std::int64_t>::max();
  int threads = 0;
  std::function<void(double, const double*, const double*)> callback = {};  // after each step
};

struct SecondOrderSolution {
  enum Status { kDone, kNonFinite, kStepUnderflow, kTooManySteps } status = kDone;
  std::vector<double> t;     // output times
  std::vector<double> x, v;  // one row per time
  std::int64_t steps = 0, evaluations = 0;
  double time = 0;  // the last good step
  // Where status is kNonFinite: what, when, and the component of x.
  std::string failure;
  double failure_time = 0;
  std::int64_t failure_component = -1;
};

// Steps to t0 + k h, the last one shortened to end at t1; outputs between them by the cubic Hermite
// polynomials of (x, v) and (v, a). A solve that fails ends with the row of the last good step.
SecondOrderSolution solve_second_order(System& system, const SecondOrderProblem& problem);

}  // namespace substep::ode
