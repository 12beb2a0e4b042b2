// What the implicit methods share: simplified Newton iterations whose matrix is kept while they
// converge, and what becomes of a step that fails.
// [HW] Hairer, Wanner, "Solving Ordinary Differential Equations II", 2nd ed., IV.8.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/ode/implicit/newton_matrices.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/stepping/one_step.h"

namespace substep::ode {

// Whether increments of norm `increment` (1: the tolerance of the step) show convergence.
class NewtonProgress {
 public:
  enum class Verdict { go_on, converged, diverged };
  static constexpr int kMost = 30;

  // Adaptive steps: an error of kappa times the tolerance is left. Fixed steps (to_rounding): until
  // rounding takes over, below 1 and no longer falling fast.
  NewtonProgress(double kappa, bool to_rounding)
      : kappa_(kappa), most_(to_rounding ? kMost : 7), to_rounding_(to_rounding) {}

  void start() {
    count_ = 0;
    rate_ = 0.0;
    // The last step's factor, and some doubt, until there are two increments to compare ([HW]
    // after (8.11)).
    eta_ = std::pow(std::max(eta_, std::numeric_limits<double>::epsilon()), 0.8);
  }
  void distrust() { eta_ = 1.0; }
  // Increments of this size are of rounding.
  void set_rounding(double increment) { rounding_ = increment; }

  Verdict next(double increment) {
    const double last = count_ > 0 ? increments_[count_ - 1] : 0.0;
    increments_[count_++] = increment;
    if (!(increment < HUGE_VAL)) return Verdict::diverged;
    if (increment <= rounding_) return Verdict::converged;
    if (count_ > 1) {
      const double ratio = increment / last;
      rate_ = count_ > 2 ? std::sqrt(ratio * rate_) : ratio;
      if (to_rounding_ && increment < 1.0 && ratio > 0.3) return Verdict::converged;
      if (rate_ >= 1.0) return Verdict::diverged;
      eta_ = rate_ / (1.0 - rate_);
      // [HW] (8.11): what would be left after the last iteration.
      const double left = eta_ * increment * std::pow(rate_, most_ - count_);
      if (left > kappa_ || count_ == most_) {
        return eta_ * increment <= kappa_ ? Verdict::converged : Verdict::diverged;
      }
    } else if (to_rounding_) {
      return Verdict::go_on;
    }
    return eta_ * increment <= kappa_ ? Verdict::converged : Verdict::go_on;  // [HW] (8.10)
  }

  double last() const { return count_ > 0 ? increments_[count_ - 1] : HUGE_VAL; }
  int count() const { return count_; }
  int most() const { return most_; }
  double rate() const { return rate_; }
  double kappa() const { return kappa_; }
  std::string history() const {
    std::string text;
    for (int k = 0; k < count_; ++k) text += (k ? ", " : "") + format(increments_[k]);
    return text;
  }

 private:
  double kappa_;
  int most_, count_ = 0;
  bool to_rounding_;
  double rate_ = 0.0, eta_ = 1.0, rounding_ = 0.0;
  double increments_[kMost] = {};
};

template <class Sys, class Matrices>
class ImplicitStep : public OneStep {
 protected:
  static constexpr int kMostHalvings = 8;  // of a fixed step

  ImplicitStep(Sys& system, const StepOptions& options, std::unique_ptr<Matrices> matrices,
               std::string_view name, int error_order)
      : OneStep(system, options, name, error_order),
        f_system_(system),
        matrices_(std::move(matrices)),
        progress_(newton_tolerance(options), fixed_),
        scale_(y_.size()),
        inverse_scale_(y_.size()),
        has_mass_(matrices_->has_mass()) {}

  std::int64_t n() const {
    if constexpr (requires { Sys::kSize; }) {
      return Sys::kSize;
    } else {
      return n_;
    }
  }

  void rhs(double t, const double* y, double* dydt) {
    ++evaluations_;
    if constexpr (requires { Sys::kSize; }) {
      f_system_.eval(t, y, dydt);
    } else {
      f_system_.rhs(t, y, dydt);
    }
  }

  // Solves the equations of a step h from (t, y) by Newton's method and sets y_new; false where it
  // does not converge, told by note_not_finite() where that is why.
  virtual bool iterate(int slot, double t, double h, const double* y, double* y_new) = 0;
  // Factorizes what iterate() needs for a step h; there is room for kSlots of them.
  virtual void factor(int slot, double h) = 0;

  // A step h from (t, y): Newton's method with the Jacobian at hand and, where that fails, with a
  // new one.
  bool solve(int slot, double t, double h, const double* y, double* y_new) {
    double& factored_h = factored_h_[slot];
    set_scale(y);
    tried_h_ = h;
    failure_ = Failure::newton;
    for (;;) {
      const bool current = jacobian_is_of(t, y);
      if (!have_jacobian_ || (jacobian_is_old_ && !current)) evaluate_jacobian(t, h, y);
      if (factored_h != h) {
        factored_h = 0.0;
        try {
          factor(slot, h);
        } catch (const SingularMatrixError& error) {
          failure_ = Failure::singular;
          singular_ = error;
          if (++singular_in_a_row_ > 5) fail(t);
          return false;
        }
        factored_h = h;
      }
      singular_in_a_row_ = 0;
      matrices_->set_accuracy(scale_.data(), progress_.kappa());
      if (iterate(slot, t, h, y, y_new)) {
        // A slow convergence asks for a new Jacobian at the next step ([HW] after (8.13)).
        jacobian_is_old_ = progress_.count() > 2 && progress_.rate() > kSlow;
        return true;
      }
      progress_.distrust();
      if (jacobian_is_of(t, y) || matrices_->constant()) {
        if (!stalled_by_rounding(slot, t, y)) return false;
        set_scale(y);
      } else {
        jacobian_is_old_ = true;
      }
    }
  }

  double error_norm(const double* e) const {
    if (rounding_.empty()) return OneStep::error_norm(e);
    return increment_norm(1, [e](int) { return e; });
  }

  // A tenth of the tolerance is enough for an estimate of the error.
  void set_estimate_accuracy() { matrices_->set_accuracy(scale_.data(), 1.0); }

  // After an accepted step: where the next one starts there is no Jacobian yet.
  bool jacobian_is_old() const { return jacobian_is_old_ && !matrices_->constant(); }

  void fixed_step(double h) override {
    for (int halvings = 0;; ++halvings) {
      parts_ = 1 << halvings;
      if (run_parts(h / parts_)) return;
      if (halvings == kMostHalvings) fail(t_);
    }
  }
  bool step_was_split() const { return parts_ > 1; }

  // The norm of an increment of `rows` rows of n.
  template <class Row>
  double increment_norm(int rows, Row&& row) const {
    double squares = 0.0;
    const double* w = inverse_scale_.data();
    for (int r = 0; r < rows; ++r) {
      const double* x = row(r);
      squares += sums<1>(n(), [=](std::int64_t i) {
        return std::array<double, 1>{x[i] * w[i] * (x[i] * w[i])};
      })[0];
    }
    return std::sqrt(squares / (rows * components()));
  }

  // The scale of fixed steps knows y only; increments that are greater than y widen it.
  void widen_scale(const double* y_new) {
    if (!fixed_) return;
    double most = 0.0;
    for (std::int64_t i = 0; i < n(); ++i) most = std::max(most, std::fabs(y_new[i]));
    for (std::int64_t i = 0; i < n(); ++i) {
      const auto k = usize(i);
      const double scale = kRounding * (std::fabs(y_new[i]) + 1e-3 * most);
      if (scale > scale_[k]) scale_[k] = scale, inverse_scale_[k] = 1.0 / scale;
    }
  }

  bool note_not_finite(double t, const double* values, int stage) {
    failure_ = Failure::not_finite;
    not_finite_.emplace(not_finite("the derivative", t, values, stage));
    return false;
  }
  bool note_error_too_large() { return failure_ = Failure::error, false; }

  // What the last attempts failed for.
  [[noreturn]] void fail(double t) const {
    if (failure_ == Failure::not_finite) throw *not_finite_;
    if (failure_ == Failure::singular) {
      throw SingularMatrixError(
          std::string(singular_->what()) + " at t = " + format(t) + ": the Newton matrix of " +
              std::string(name_) +
              " is singular whatever the step; an algebraic equation may not determine its "
              "unknown (index above 1), or the Jacobian is wrong",
          t, singular_->index, steps_);
    }
    if (failure_ == Failure::error) throw step_too_small(t_, steps_);
    throw ConvergenceError(
        "Newton's iteration does not converge at t = " + format(t) + " in steps down to " +
            format(std::fabs(tried_h_)) +
            "; increments in units of the tolerance: " + progress_.history() +
            "; check jac (check_jacobian=True), or the function may have a kink here",
        t, -1, steps_);
  }

  Sys& f_system_;
  std::unique_ptr<Matrices> matrices_;
  NewtonProgress progress_;
  std::vector<double> scale_, inverse_scale_;
  bool has_mass_;

 private:
  enum class Failure { newton, singular, not_finite, error };
  static constexpr double kSlow = 1e-3;
  static constexpr double kRounding = 1e-12;  // fixed steps: relative size of 1 in the norm

  // [HW] (8.10); RADAU5 has 0.03 for our 0.003, which shows in the error of loose tolerances.
  static double newton_tolerance(const StepOptions& options) {
    if (options.step > 0.0) return 0.01;
    const double rtol = *std::min_element(options.rtol.begin(), options.rtol.end());
    const double least = 10.0 * std::numeric_limits<double>::epsilon() / rtol;
    return std::max(least, std::min(0.003, std::sqrt(rtol)));
  }

  void set_scale(const double* y) {
    double* scale = scale_.data();
    if (fixed_) {
      std::fill(scale_.begin(), scale_.end(), std::numeric_limits<double>::min());
      widen_scale(y);
    } else if (complex_pairs_) {
      tolerance_.with_scale([&](auto&& of) {
        for (std::int64_t i = 0; i < n() / 2; ++i) {
          scale[2 * i] = scale[2 * i + 1] = of(i, std::hypot(y[2 * i], y[2 * i + 1]));
        }
      });
    } else {
      tolerance_.with_scale([&](auto&& of) {
        for (std::int64_t i = 0; i < n(); ++i) scale[i] = of(i, std::fabs(y[i]));
      });
    }
    for (std::size_t i = 0; i < rounding_.size(); ++i) scale[i] += kOverRounding * rounding_[i];
    double* inverse = inverse_scale_.data();
    for (std::int64_t i = 0; i < n(); ++i) inverse[i] = 1.0 / scale[i];
    if (!rounding_.empty())
      progress_.set_rounding(kNoise * increment_norm(1, [&](int) { return rounding_.data(); }));
  }

  // Whether the increments are no greater than what rounding y, the least that can be, does to them
  // in an adaptive step. No tolerance is below a multiple of that from then on.
  bool stalled_by_rounding(int slot, double t, const double* y) {
    if (fixed_ || failure_ != Failure::newton || !(progress_.last() < 1.0)) return false;
    std::vector<double> near(y_.size()), f(y_.size()), changed(y_.size()), most(rounding_);
    most.resize(y_.size());
    constexpr double epsilon = std::numeric_limits<double>::epsilon();
    rhs(t, y, f.data());
    for (int pattern = 1; pattern <= 4; pattern *= 2) {  // +-+-.., ++--.., ++++----..
      for (std::size_t i = 0; i < near.size(); ++i)
        near[i] = y[i] * ((static_cast<int>(i) & pattern) != 0 ? 1.0 - epsilon : 1.0 + epsilon);
      rhs(t, near.data(), changed.data());
      for (std::size_t i = 0; i < near.size(); ++i) changed[i] -= f[i];
      if (!all_finite(changed.data(), n())) return false;
      matrices_->solve(slot, changed.data());
      for (std::size_t i = 0; i < near.size(); ++i)
        most[i] = std::max(most[i], std::fabs(changed[i]));
    }
    const double noise = kNoise * increment_norm(1, [&](int) { return most.data(); });
    if (most == rounding_ || progress_.last() > noise) return false;
    rounding_ = std::move(most);
    return true;
  }

  // With a mass matrix f is not y': the step grows from a short one.
  double first_step() override {
    if (!has_mass_) return OneStep::first_step();
    return std::min(1e-6 * std::fabs(t_bound_ - t_), max_step_);
  }

  bool jacobian_is_of(double t, const double* y) const {
    return have_jacobian_ && jacobian_t_ == t && jacobian_steps_ == steps_ && jacobian_y_ == y;
  }

  void evaluate_jacobian(double t, double h, const double* y) {
    const double* f = f_.data();
    if (y != y_.data() || !f_is_current()) {
      f_here_.resize(y_.size());
      rhs(t, y, f_here_.data());
      f = f_here_.data();
    }
    evaluations_ += matrices_->evaluate({t, h, y, f, scale_.data(), has_mass_});
    jacobians_ += !matrices_->constant();
    have_jacobian_ = true;
    jacobian_is_old_ = false;
    jacobian_t_ = t, jacobian_y_ = y, jacobian_steps_ = steps_;
    for (double& factored : factored_h_) factored = 0.0;
  }

  // Whether f_ is f(t_, y_).
  virtual bool f_is_current() const = 0;

  bool run_parts(double h) {
    if (parts_ == 1) return solve(0, t_, h, y_.data(), y_new_.data());
    part_ = y_;
    for (int part = 0; part < parts_; ++part) {
      if (!solve(0, t_ + part * h, h, part_.data(), y_new_.data())) return false;
      part_.swap(y_new_);
    }
    y_new_ = part_;
    return true;
  }

  static constexpr double kNoise = 4.0, kOverRounding = 10.0;

  std::vector<double> f_here_, part_;
  std::vector<double> rounding_;  // of each component, once it has stopped Newton's iteration
  bool have_jacobian_ = false, jacobian_is_old_ = false;
  double jacobian_t_ = 0.0;
  std::int64_t jacobian_steps_ = 0;
  const double* jacobian_y_ = nullptr;
  double factored_h_[NewtonMatrices::kSlots] = {}, tried_h_ = 0.0;
  int singular_in_a_row_ = 0, parts_ = 1;
  Failure failure_ = Failure::newton;
  std::optional<NonFiniteError> not_finite_;
  std::optional<SingularMatrixError> singular_;
};

}  // namespace substep::ode
