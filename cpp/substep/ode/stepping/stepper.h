// One integration in progress: steps from t to t_bound, and the polynomial over the last step.
#pragma once

#include <cstdint>
#include <memory>
#include <string_view>

#include "substep/ode/stepping/system.h"

namespace substep::ode {

class Stepper {
 public:
  Stepper() = default;
  Stepper(const Stepper&) = delete;
  Stepper& operator=(const Stepper&) = delete;
  virtual ~Stepper() = default;

  virtual std::int64_t size() const = 0;
  double t() const { return t_; }
  double t_old() const { return t_old_; }  // start of the last step
  double t_bound() const { return t_bound_; }
  virtual const double* y() const = 0;
  virtual const double* y_old() const = 0;
  std::int64_t evaluations() const { return evaluations_; }
  std::int64_t jacobians() const { return jacobians_; }            // evaluations of df/dy
  std::int64_t factorizations() const { return factorizations_; }  // LU decompositions
  std::int64_t steps() const { return steps_; }                    // accepted so far
  bool finished() const { return t_ == t_bound_; }

  // Evaluates f(t, y) and chooses the first step; the first step() does so if nobody did.
  virtual void start() = 0;

  // One accepted step; an exception leaves t and y as they were.
  virtual void step() = 0;

  // Fixed steps only: number of whole steps from the start to t, and `steps` of them at once.
  // What the steps between passed through is not kept.
  virtual bool fixed() const = 0;
  virtual std::int64_t fixed_index(double t) const = 0;
  virtual double fixed_time(std::int64_t index) const = 0;
  virtual void advance(std::int64_t steps) = 0;

  // The polynomial over the last step: rows F of size() each for interpolate(). May evaluate f.
  virtual int dense_rows() const = 0;
  virtual void dense(double* rows) = 0;

 protected:
  double t_ = 0.0, t_old_ = 0.0, t_bound_ = 0.0;
  std::int64_t evaluations_ = 0, jacobians_ = 0, factorizations_ = 0, steps_ = 0;
};

// u(theta) = y_old + theta (F_1 + (1 - theta) (F_2 + theta (F_3 + (1 - theta) (F_4 + ...)))),
// the nested form of Hairer's DOPRI5 and DOP853; F_1..F_3 alone are the cubic Hermite polynomial.
inline double interpolate(int rows, std::int64_t n, double theta, const double* y_old,
                          const double* F, std::int64_t i) {
  double u = 0.0;
  for (int r = rows - 1; r >= 0; --r) u = (u + F[r * n + i]) * (r % 2 == 0 ? theta : 1.0 - theta);
  return y_old[i] + u;
}

}  // namespace substep::ode
