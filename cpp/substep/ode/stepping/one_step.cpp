#include "substep/ode/stepping/one_step.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "substep/core/usize.h"
#include "substep/ode/stepping/combine.h"

namespace substep::ode {

OneStep::OneStep(System& system, const StepOptions& options, std::string_view name, int error_order)
    : system_(system),
      n_(system.size()),
      name_(name),
      error_order_(error_order),
      tolerance_(options.rtol, options.atol, options.complex_pairs ? n_ / 2 : n_),
      fixed_(options.step > 0.0),
      complex_pairs_(options.complex_pairs),
      threads_(options.threads),
      h_abs_(options.first_step),
      max_step_(options.max_step),
      direction_(options.t_bound >= options.t ? 1.0 : -1.0),
      y_(options.y, options.y + n_),
      y_old_(y_),
      y_new_(y_),
      f_(usize(n_)) {
  t_ = t_old_ = options.t;
  t_bound_ = options.t_bound;
  if (fixed_) grid_ = FixedGrid(t_, t_bound_, options.step);
}

void OneStep::start() {
  if (started_) return;
  evaluate(t_, y_.data(), f_.data());
  started_ = true;
  if (!fixed_ && h_abs_ == 0.0 && all_finite(f_.data(), n_)) h_abs_ = first_step();
}

void OneStep::step() {
  if (finished()) throw InputError("the integration has reached its end");
  start();
  if (!all_finite(f_.data(), n_)) throw not_finite("the derivative", t_, f_.data(), 1);
  if (!fixed_) return adaptive_step();
  fixed_step(grid_.length(steps_, t_));
  accept(grid_.time(steps_ + 1));
}

void OneStep::advance(std::int64_t count) {
  for (const std::int64_t last = steps_ + count; steps_ < last && !finished();) step();
}

double OneStep::first_step() {
  std::vector<double> there(y_.size()), f1(y_.size());
  return starting_step(tolerance_, complex_pairs_, n_, y_.data(), f_.data(),
                       std::fabs(t_bound_ - t_), max_step_, error_order_, [&](double h0) {
                         for (std::size_t i = 0; i < y_.size(); ++i) {
                           there[i] = y_[i] + direction_ * h0 * f_[i];
                         }
                         evaluate(t_ + direction_ * h0, there.data(), f1.data());
                         return f1.data();
                       });
}

void OneStep::accept(double t_new) {
  std::swap(y_old_, y_);
  std::swap(y_, y_new_);
  t_old_ = t_;
  t_ = t_new;
  ++steps_;
}

double OneStep::end_of_step(double& h_abs) const {
  double t_new = t_ + direction_ * h_abs;
  if (direction_ * (t_new - t_bound_) > 0.0) t_new = t_bound_;
  h_abs = std::fabs(t_new - t_);
  return t_new;
}

double OneStep::error_norm(const double* e) const {
  const auto squares =
      scaled_squares_of_rows<1>(tolerance_, complex_pairs_, n_, y_.data(), y_new_.data(), {e});
  return std::sqrt(squares[0] / components());
}

NonFiniteError OneStep::not_finite(const char* what, double t, const double* values,
                                   int stage) const {
  std::int64_t i = 0;
  while (i + 1 < n_ && std::isfinite(values[i])) ++i;
  return not_finite_in_step(what, t, complex_pairs_ ? i / 2 : i, stage, name_, steps_, t_);
}

}  // namespace substep::ode
