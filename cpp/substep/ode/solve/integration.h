// Drives a Stepper from t to t_bound and keeps what was asked for: every step, given times, the
// polynomials between.
#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "substep/ode/stepping/stepper.h"

namespace substep::ode {

// Polynomials over consecutive steps, t rising or falling.
struct DenseSolution {
  std::int64_t size = 0;
  int rows = 0;
  std::vector<double> times;    // where the steps begin and the last one ends
  std::vector<double> lengths;  // of the whole steps: the last may have been cut by an event
  std::vector<double> starts;   // y at the start of each
  std::vector<double> F;

  std::int64_t steps() const { return static_cast<std::int64_t>(lengths.size()); }
  // y at t into out[i * stride]; at the end of a step, that step's polynomial counts.
  void evaluate(double t, double* out, std::int64_t stride) const;
};

struct Output {
  bool every_step = true;
  std::vector<double> t_eval;  // in the direction of time; used where every_step is false
  bool dense = false;          // keep the polynomials
  bool interpolate = false;    // the last step's polynomial is asked for now and then
};

class Integration {
 public:
  Integration(std::shared_ptr<System> system, std::string_view method, const StepOptions& options,
              Output output);

  // Evaluates f at the start and chooses the first step.
  void start();

  // Up to `steps` steps; the number taken. Records as it goes; an exception leaves what the steps
  // before it recorded.
  std::int64_t run(std::int64_t steps);

  // The last step's polynomial at t.
  void interpolate(double t, double* out, std::int64_t stride = 1);

  // A copy of it.
  DenseSolution step_dense();

  // Forgets what was recorded beyond t, which lies in the last step.
  void truncate(double t);

  System& system() { return *system_; }
  const Stepper& stepper() const { return *stepper_; }
  std::vector<double>& times() { return times_; }
  std::vector<double>& states() { return states_; }  // one row of size() for each time
  DenseSolution& dense() { return dense_; }

 private:
  class InUse;

  void record();
  bool leap(std::int64_t steps);
  void push(double t, const double* y);
  const double* polynomial();
  void polynomial_at(double t, double* out, std::int64_t stride);

  std::shared_ptr<System> system_;
  std::unique_ptr<Stepper> stepper_;
  Output output_;
  std::vector<double> times_, states_, F_;
  std::int64_t polynomial_step_ = -1;  // the step that F_ belongs to
  std::size_t next_eval_ = 0;
  double direction_;
  DenseSolution dense_;
  std::atomic<std::thread::id> user_{};
};

}  // namespace substep::ode
