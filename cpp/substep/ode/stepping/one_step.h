// What the steppers that are no tables share: state, tolerances, fixed and adaptive steps.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "substep/ode/stepping/fixed_grid.h"
#include "substep/ode/stepping/step_control.h"
#include "substep/ode/stepping/stepper.h"

namespace substep::ode {

class OneStep : public Stepper {
 public:
  OneStep(System& system, const StepOptions& options, std::string_view name, int error_order);

  std::int64_t size() const final { return n_; }
  const double* y() const final { return y_.data(); }
  const double* y_old() const final { return y_old_.data(); }
  void start() final;
  void step() final;
  bool fixed() const final { return fixed_; }
  std::int64_t fixed_index(double t) const final { return grid_.index(t); }
  double fixed_time(std::int64_t index) const final { return grid_.time(index); }
  void advance(std::int64_t count) final;

 protected:
  // A step of the given length (with sign) into y_new_.
  virtual void fixed_step(double h) = 0;

  // An accepted step of a length that the method chooses, begun with h_abs_: ends with accept().
  virtual void adaptive_step() = 0;

  // The first step of an adaptive integration, from f_ = f(t, y).
  virtual double first_step();

  void evaluate(double t, const double* y, double* f) {
    ++evaluations_;
    system_.rhs(t, y, f);
  }

  // y_new_ becomes y_; f_ is then that of the step's start unless the method has swapped it.
  void accept(double t_new);

  // Where a step of h_abs would end, t_bound at the most; h_abs becomes its exact length.
  double end_of_step(double& h_abs) const;

  // Root mean square of e_i / (atol + rtol max(|y|, |y_new|)).
  double error_norm(const double* e) const;

  double components() const { return static_cast<double>(complex_pairs_ ? n_ / 2 : n_); }

  // Names the first component of values that is not finite.
  NonFiniteError not_finite(const char* what, double t, const double* values, int stage) const;

  System& system_;
  std::int64_t n_;
  std::string_view name_;
  int error_order_;
  Tolerance tolerance_;
  bool fixed_, complex_pairs_;
  int threads_;
  double h_abs_, max_step_, direction_;
  FixedGrid grid_;
  std::vector<double> y_, y_old_, y_new_, f_;  // f_ = f(t_, y_)

 private:
  bool started_ = false;
};

}  // namespace substep::ode
