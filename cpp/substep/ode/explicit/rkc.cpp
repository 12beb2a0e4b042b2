#include "substep/ode/explicit/rkc.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "substep/core/interrupt.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/ode/explicit/rkc_formula.h"
#include "substep/ode/explicit/rkc_stage.h"
#include "substep/ode/explicit/spectral_radius.h"
#include "substep/ode/stepping/one_step.h"

namespace substep::ode {
namespace {

// Step control as in [SSV] (rkc_formula.h) and their code, rkc.f of netlib/ode, named by routine.
constexpr double kSafe = 0.8, kShrink = 0.1, kGrow = 10.0;
constexpr int kMaxStages = 1000;
constexpr double kHopelessSteps = 1e5;  // so many steps of all stages are not begun
constexpr std::int64_t kGrain = 4096;   // components per chunk of a loop over vectors
constexpr int kPollEvery = 16;          // stages

class Rkc2 final : public OneStep {
 public:
  Rkc2(System& system, const StepOptions& options)
      : OneStep(system, options, kRkc2, 2),
        // [SSV] estimate anew after 25 steps; a fixed step has no rejection that would tell
        // earlier.
        radius_(system, options.spectral_radius, std::fabs(options.t_bound - options.t),
                options.step > 0.0 ? 1 : 25),
        spare_(y_),
        f_new_(f_) {
    // Rounding errors grow as s^2: [SSV], rkc.
    const double rtol = *std::min_element(options.rtol.begin(), options.rtol.end());
    const double rounding = std::sqrt(rtol / (10.0 * std::numeric_limits<double>::epsilon()));
    max_stages_ = static_cast<int>(std::clamp(rounding, 2.0, 1.0 * kMaxStages));
  }

  // The cubic Hermite polynomial: [SSV], rkcint.
  int dense_rows() const override { return 3; }
  void dense(double* F) override {
    const double h = t_ - t_old_;
    for (std::int64_t i = 0; i < n_; ++i) {
      const auto k = usize(i);
      const double difference = y_[k] - y_old_[k];
      F[i] = difference;
      F[n_ + i] = h * f_new_[k] - difference;
      F[2 * n_ + i] = 2.0 * difference - h * (f_new_[k] + f_[k]);
    }
  }

 protected:
  void fixed_step(double h) override {
    const double radius = spectral_radius();
    const double stages = RkcFormula::stages_for(std::fabs(h) * radius);
    if (stages > kMaxStages) throw too_many_stages(h, stages, radius);
    run_stages(h, static_cast<int>(stages));
    if (!all_finite(y_new_.data(), n_)) throw trace_not_finite(h);
    evaluate(t_ + h, y_new_.data(), f_new_.data());
    std::swap(f_, f_new_);
  }

  void adaptive_step() override {
    const double smallest = smallest_step(t_, direction_);
    double h_abs = std::clamp(h_abs_, smallest, std::max(max_step_, smallest));
    double error = 1.0;
    for (;;) {
      if (h_abs < smallest) {
        if (std::isnan(error)) throw trace_not_finite(direction_ * h_abs);
        throw step_too_small(t_, steps_);
      }
      const double left = std::fabs(t_bound_ - t_);
      if (1.1 * h_abs >= left && left <= max_step_) h_abs = left;
      h_abs = std::min(h_abs, longest_step());
      const double t_new = end_of_step(h_abs);
      const double stages = RkcFormula::stages_for(h_abs * radius_.value());
      run_stages(t_new - t_, static_cast<int>(std::min<double>(stages, max_stages_)));
      error = local_error(t_new - t_);
      if (error <= 1.0) {
        h_abs_ = h_abs * growth(h_abs, error);
        h_before_ = error > 0.0 ? h_abs : 0.0;
        error_before_ = error;
        std::swap(f_, f_new_);
        return accept(t_new);
      }
      h_abs *= std::isnan(error) ? kShrink : std::max(kShrink, kSafe / std::cbrt(error));
      radius_.step_rejected();
    }
  }

  // [SSV], rkclow: h = 1 / rho; one step of Euler's method with it tells what the error of a
  // step would be.
  double first_step() override {
    const double span = std::min(std::fabs(t_bound_ - t_), max_step_);
    const double h =
        std::min(span, std::max(1.0 / spectral_radius(), smallest_step(t_, direction_)));
    for (std::size_t i = 0; i < y_.size(); ++i) y_new_[i] = y_[i] + direction_ * h * f_[i];
    evaluate(t_ + direction_ * h, y_new_.data(), f_new_.data());
    const double error = h * weighted_norm(y_.data(), [&](std::int64_t i) {
                           return f_new_[usize(i)] - f_[usize(i)];
                         });
    return 0.1 * h < span * std::sqrt(error) ? 0.1 * h / std::sqrt(error) : span;
  }

 private:
  double spectral_radius() {
    const std::int64_t before = radius_.evaluations();
    const double radius = radius_.at(t_, y_.data(), f_.data(), steps_);
    evaluations_ += radius_.evaluations() - before;
    return radius;
  }

  // What max_stages_ allow.
  double longest_step() {
    const double radius = spectral_radius(), left = std::fabs(t_bound_ - t_);
    const double longest = RkcFormula::reach(max_stages_) / radius;  // infinite for radius 0
    if (left <= kHopelessSteps * longest) return longest;
    throw SolverError("the spectral radius " + format(radius) + " at t = " + format(t_) +
                          " limits steps of " + std::to_string(max_stages_) + " stages to " +
                          format(longest) + ", with " + format(left) +
                          " left to go: too stiff for RKC2; take an implicit method ('Radau', "
                          "'implicit_euler')",
                      t_, -1, steps_);
  }

  SolverError too_many_stages(double h, double stages, double radius) const {
    return SolverError("step: " + format(std::fabs(h)) + " takes " + format(stages) +
                           " stages at t = " + format(t_) + ", where the spectral radius is " +
                           format(radius) + ", more than " + std::to_string(kMaxStages) +
                           ": take steps below " + format(RkcFormula::reach(kMaxStages) / radius) +
                           " or an implicit method ('Radau', 'implicit_euler')",
                       t_, -1, steps_);
  }

  // The predictive controller: [SSV], rkclow.
  double growth(double h, double error) const {
    if (error == 0.0) return kGrow;
    double factor = kSafe / std::cbrt(error);
    if (h_before_ > 0.0) factor *= h / h_before_ * std::cbrt(error_before_ / error);
    return std::clamp(factor, kShrink, kGrow);
  }

  // A step of the given length (with sign) into y_new_.
  void run_stages(double h, int stages) {
    if (!formula_ || formula_->stages() != stages) formula_.emplace(stages);
    begin_stages(h);
    for (int j = 2; j <= stages; ++j) {
      if (j % kPollEvery == 0) poll_interrupt();
      const RkcStage s = stage(j, h);
      ++evaluations_;
      if (!system_.rkc_stage(s)) {
        double* f = f_new_.data();
        system_.rhs(s.t, s.y1, f);
        over_components([&](std::int64_t i) { s.y2[i] = s.sum(i, f[i]); });
      }
      std::swap(y_new_, spare_);
    }
  }

  // y_0 and y_1.
  void begin_stages(double h) {
    const double first = formula_->stage(1).mu_tilde * h;
    const double *y = y_.data(), *f = f_.data();
    double *y_1 = y_new_.data(), *y_0 = spare_.data();
    over_components([=](std::int64_t i) {
      y_0[i] = y[i];
      y_1[i] = multiply_add(first, f[i], y[i]);
    });
  }

  // From y_{j-1} = y_new_ and y_{j-2} = spare_, which y_j replaces.
  RkcStage stage(int j, double h) {
    const RkcFormula::Stage& s = formula_->stage(j);
    return {.t = t_ + formula_->stage(j - 1).c * h,
            .rest = 1.0 - s.mu - s.nu,
            .mu = s.mu,
            .nu = s.nu,
            .mu_h = s.mu_tilde * h,
            .gamma_h = s.gamma_tilde * h,
            .y0 = y_.data(),
            .f0 = f_.data(),
            .y1 = y_new_.data(),
            .y2 = spare_.data(),
            .threads = threads_};
  }

  // The norm of 0.8 (y - y_new) + 0.4 h (f + f_new): [SSV], rkclow; NaN if something is not finite.
  double local_error(double h) {
    evaluate(t_ + h, y_new_.data(), f_new_.data());
    const double *y = y_.data(), *y_new = y_new_.data(), *f = f_.data(), *f_new = f_new_.data();
    const double error = weighted_norm(y_new, [=](std::int64_t i) {
      return multiply_add(0.4 * h, f[i] + f_new[i], 0.8 * (y[i] - y_new[i]));
    });
    return std::isfinite(error) ? error : std::nan("");
  }

  // The root mean square of e(i) / (atol + rtol max(|y|, |y_new|)). With complex pairs a component
  // is a pair and |.| its modulus.
  template <class Error>
  double weighted_norm(const double* y_new, Error&& e) {
    const double* y = y_.data();
    return tolerance_.with_scale([&](auto&& scale) {
      if (!complex_pairs_) {
        return root_mean(n_, [&](std::int64_t i) {
          const double a = std::fabs(y[i]), b = std::fabs(y_new[i]);
          const double ratio = e(i) / scale(i, a > b ? a : b);
          return std::array{ratio * ratio};
        });
      }
      return root_mean(n_ / 2, [&](std::int64_t i) {
        const std::int64_t re = 2 * i, im = re + 1;
        const double size = std::max(std::hypot(y[re], y[im]), std::hypot(y_new[re], y_new[im]));
        const double ratio = std::hypot(e(re), e(im)) / scale(i, size);
        return std::array{ratio * ratio};
      });
    });
  }

  // Chunks are summed in order.
  template <class Square>
  double root_mean(std::int64_t n, Square&& square) {
    partial_.resize(usize((n - 1) / kGrain + 1));
    parallel_for(
        n, kGrain,
        [&](std::int64_t begin, std::int64_t end) {
          partial_[usize(begin / kGrain)] =
              sums<1>(end - begin, [&](std::int64_t i) { return square(begin + i); })[0];
        },
        threads_);
    double total = 0.0;
    for (const double part : partial_) total += part;
    return std::sqrt(total / static_cast<double>(n));
  }

  template <class One>
  void over_components(One&& one) {
    parallel_for(
        n_, kGrain,
        [&](std::int64_t begin, std::int64_t end) {
#pragma GCC ivdep
          for (std::int64_t i = begin; i < end; ++i) one(i);
        },
        threads_);
  }

  // Which stage of a step that failed brought the first NaN or infinity: they are done again.
  NonFiniteError trace_not_finite(double h) {
    const int stages = formula_->stages();
    begin_stages(h);
    for (int j = 2;; ++j) {
      const double t = j <= stages ? stage(j, h).t : t_ + h;
      if (!all_finite(y_new_.data(), n_)) return not_finite("the state", t, y_new_.data(), j - 1);
      evaluate(t, y_new_.data(), f_new_.data());
      if (j > stages || !all_finite(f_new_.data(), n_)) {
        return not_finite("the derivative", t, f_new_.data(), j);
      }
      const RkcStage s = stage(j, h);
      over_components([&](std::int64_t i) { s.y2[i] = s.sum(i, f_new_[usize(i)]); });
      std::swap(y_new_, spare_);
    }
  }

  SpectralRadius radius_;
  int max_stages_;
  double h_before_ = 0.0, error_before_ = 0.0;  // of the last accepted step, 0 without error
  std::optional<RkcFormula> formula_;
  std::vector<double> spare_;
  std::vector<double> f_new_;    // f at the end of the step; after it, f at its start
  std::vector<double> partial_;  // sums over chunks
};

}  // namespace

std::unique_ptr<Stepper> make_rkc2(System& system, const StepOptions& options) {
  return std::make_unique<Rkc2>(system, options);
}

}  // namespace substep::ode
