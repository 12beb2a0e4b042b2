// Implicit Euler: M (y_new - y) = h f(t + h, y_new), [HW] IV.1 (1.8). Adaptive by step doubling as
// the explicit methods without an estimate of their own: one step against two halves, and on from
// the halves as they are, since adding their difference (local extrapolation) would cost
// A-stability.
#pragma once

#include "substep/core/tableau.h"
#include "substep/core/usize.h"
#include "substep/ode/implicit/implicit_step.h"

namespace substep::ode {

template <class Sys, class Matrices>
class ImplicitEulerStepper final : public ImplicitStep<Sys, Matrices> {
  using Base = ImplicitStep<Sys, Matrices>;
  using Table = ImplicitEuler;

 public:
  ImplicitEulerStepper(Sys& system, const StepOptions& options, std::unique_ptr<Matrices> matrices)
      : Base(system, options, std::move(matrices), Table::name, Table::order) {
    const std::size_t size = y_.size();
    slope_.resize(size), last_slope_.resize(size), z_.resize(size), residual_.resize(size);
    y_whole_.resize(size), y_half_.resize(size);
    if (has_mass_) Mz_.resize(size);
  }

  // A straight line: as accurate as the method, and without overshoots.
  int dense_rows() const override { return 1; }
  void dense(double* F) override {
    for (std::int64_t i = 0; i < Base::n(); ++i) F[i] = y_[usize(i)] - y_old_[usize(i)];
  }

 private:
  using Base::direction_;
  using Base::h_abs_;
  using Base::has_mass_;
  using Base::matrices_;
  using Base::max_step_;
  using Base::progress_;
  using Base::t_;
  using Base::y_;
  using Base::y_new_;
  using Base::y_old_;

  bool f_is_current() const override { return this->steps_ == 0; }

  void factor(int slot, double h) override {
    matrices_->factor(slot, 1.0 / h);
    this->factorizations_ += matrices_->factorizes();
  }

  // Newton for z = y_new - y: (M/h - J) dz = f(t + h, y + z) - M z/h, begun with z = h slope.
  bool iterate(int slot, double t, double h, const double* y, double* y_new) override {
    const std::int64_t n = Base::n();
    const double inverse = 1.0 / h, at = t + h;
    double *z = z_.data(), *r = residual_.data(), *slope = slope_.data();
    for (std::int64_t i = 0; i < n; ++i) z[i] = h * slope[i];
    progress_.start();
    for (;;) {
      for (std::int64_t i = 0; i < n; ++i) y_new[i] = y[i] + z[i];
      this->rhs(at, y_new, r);
      if (!all_finite(r, n)) return this->note_not_finite(at, r, 1);
      const double* Mz = z;
      if (has_mass_) matrices_->multiply_mass(z, Mz_.data()), Mz = Mz_.data();
      for (std::int64_t i = 0; i < n; ++i) r[i] -= Mz[i] * inverse;
      matrices_->solve(slot, r);
      for (std::int64_t i = 0; i < n; ++i) y_new[i] = y[i] + (z[i] += r[i]);
      if (progress_.count() == 0) this->widen_scale(y_new);
      const auto verdict = progress_.next(this->increment_norm(1, [r](int) { return r; }));
      if (verdict == NewtonProgress::Verdict::diverged) return false;
      if (verdict == NewtonProgress::Verdict::converged) break;
    }
    return all_finite(y_new, n);
  }

  void set_slope(const double* from, const double* to, double h) {
    const double inverse = 1.0 / h;
    for (std::int64_t i = 0; i < Base::n(); ++i) slope_[usize(i)] = (to[i] - from[i]) * inverse;
  }

  void fixed_step(double h) override {
    Base::fixed_step(h);
    set_slope(y_.data(), y_new_.data(), h);
  }

  void adaptive_step() override {
    const double smallest = smallest_step(t_, direction_);
    constexpr double exponent = -1.0 / (Table::order + 1);
    double h_abs = h_abs_ > max_step_ ? max_step_ : std::max(h_abs_, smallest);
    bool rejected = false;
    for (;;) {
      if (h_abs < smallest) this->fail(t_);
      const double t_new = this->end_of_step(h_abs);
      if (!doubled(t_new - t_)) {
        h_abs *= 0.5;
        rejected = true;
        continue;
      }
      const double error = this->error_norm(z_.data());
      if (!(error < 1.0)) {
        this->note_error_too_large();
        h_abs *= shrink_factor(error, exponent);
        rejected = true;
        continue;
      }
      const double factor = grow_factor(error, exponent, rejected);
      // The factors are kept where the step would hardly grow, as in Radau.
      const bool same = factor < 1.2 && !this->jacobian_is_old();
      h_abs_ = same ? h_abs : h_abs * factor;
      set_slope(y_half_.data(), y_new_.data(), 0.5 * (t_new - t_));
      last_slope_ = slope_;
      this->accept(t_new);
      return;
    }
  }

  // A whole step into y_whole and two halves into y_new; their difference, the error of the halves
  // ([HNW] II.4 (4.4) with p = 1), into z.
  bool doubled(double h) {
    const double half = 0.5 * h;
    const std::int64_t n = Base::n();
    slope_ = last_slope_;
    double *whole = y_whole_.data(), *middle = y_half_.data(), *y_new = y_new_.data();
    if (!this->solve(0, t_, h, y_.data(), whole)) return false;
    set_slope(y_.data(), whole, h);
    if (!this->solve(1, t_, half, y_.data(), middle)) return false;
    set_slope(middle, whole, half);
    if (!this->solve(1, t_ + half, half, middle, y_new)) return false;
    for (std::int64_t i = 0; i < n; ++i) z_[usize(i)] = y_new[i] - whole[i];
    return true;
  }

  std::vector<double> slope_, last_slope_, z_, residual_, Mz_, y_whole_, y_half_;
};

}  // namespace substep::ode
