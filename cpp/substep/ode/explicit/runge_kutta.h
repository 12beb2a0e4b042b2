// The explicit Runge-Kutta kernel: one class for every tableau and every system. A system with a
// static size (StaticSystem) is inlined into it and its loops unrolled.
#pragma once

#include <array>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <new>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "substep/core/tableau.h"
#include "substep/core/usize.h"
#include "substep/ode/stepping/combine.h"
#include "substep/ode/stepping/fixed_grid.h"
#include "substep/ode/stepping/step_control.h"
#include "substep/ode/stepping/stepper.h"

namespace substep::ode {

// What stages hold of a step h from t that failed: which evaluation brought the first NaN or
// infinity.
struct FailedStages {
  std::string_view method;
  int stages;
  std::span<const double> c;
  std::span<double* const> k;
};
NonFiniteError stage_not_finite(const FailedStages& failed, std::int64_t n, bool complex_pairs,
                                const double* y_new, double t, double h, std::int64_t steps);

template <class T, class Sys>
class RungeKutta final : public Stepper {
 public:
  static constexpr bool kDoubling = T::estimate == Estimate::doubling;

  RungeKutta(Sys& system, const StepOptions& options)
      : system_(system),
        dynamic_size_(system.size()),
        tolerance_(options.rtol, options.atol, options.complex_pairs ? size() / 2 : size()),
        fixed_(options.step > 0.0),
        complex_pairs_(options.complex_pairs),
        local_extrapolation_(options.local_extrapolation),
        threads_(options.threads),
        h_abs_(options.first_step),
        max_step_(options.max_step) {
    t_ = t_old_ = options.t;
    t_bound_ = options.t_bound;
    direction_ = t_bound_ >= t_ ? 1.0 : -1.0;
    if (fixed_) grid_ = FixedGrid(t_, t_bound_, options.step);
    const auto n = usize(size());
    const std::size_t rows = 4 + kRows + (kDoubling ? 3 : 0);
    // Rows that are never used cost no memory: a system's own kernel needs no stages.
    memory_.reset(static_cast<double*>(std::calloc(rows * n + 1, sizeof(double))));
    if (!memory_) throw std::bad_alloc();
    double* next = memory_.get();
    const auto take = [&] { return std::exchange(next, next + n); };
    y_ = take(), y_old_ = take(), y_new_ = take(), stage_ = take();
    for (double*& row : k_) row = take();
    if constexpr (kDoubling) y_whole_ = take(), y_half_ = take(), k_half_ = take();
    std::copy_n(options.y, n, y_);
  }

  std::int64_t size() const override {
    if constexpr (requires { Sys::kSize; }) {
      return Sys::kSize;
    } else {
      return dynamic_size_;
    }
  }
  const double* y() const override { return y_; }
  const double* y_old() const override { return y_old_; }

  void start() override {
    if (started_) return;
    started_ = true;
    if (fixed_) return;
    evaluate(t_, y_, k_[kEnd]);
    have_end_ = true;
    if (h_abs_ == 0.0 && all_finite(k_[kEnd], size())) h_abs_ = first_step();
  }

  void step() override {
    if (finished()) throw InputError("the integration has reached its end");
    start();
    if (have_end_) {
      std::swap(k_[0], k_[kEnd]);  // f at the end of the last step begins this one
    } else {
      evaluate(t_, y_, k_[0]);
    }
    have_end_ = false;
    try {
      fixed_ ? fixed_step() : adaptive_step();
    } catch (...) {
      std::swap(k_[0], k_[kEnd]);
      have_end_ = true;
      throw;
    }
  }

  bool fixed() const override { return fixed_; }

  std::int64_t fixed_index(double t) const override { return grid_.index(t); }
  double fixed_time(std::int64_t index) const override { return grid_.time(index); }

  void advance(std::int64_t count) override {
    const std::int64_t index = steps_, whole = std::min(count, grid_.whole_steps() - index);
    if (whole > 0) {
      std::copy_n(y_, size(), y_new_);
      const FixedRun run{T::name, grid_.t_start(), grid_.h(), whole, y_new_, threads_, index};
      if (system_.fixed_steps(run) && all_finite(y_new_, size())) {
        // One whole step is known with both its ends; of several only the end is.
        accept(grid_.time(index + whole));
        t_old_ = grid_.time(index + whole - 1);
        steps_ = index + whole;
        evaluations_ += T::stages * whole;
        have_end_ = false;
      }
    }
    while (steps_ < index + count && !finished()) step();
  }

  int dense_rows() const override { return 3 + T::dense_rows; }

  void dense(double* F) override {
    const double h = t_ - t_old_;
    const std::int64_t n = size();
    if (!have_end_) {
      evaluate(t_, y_, k_[kEnd]);
      have_end_ = true;
    }
    extra_stages(h, std::make_index_sequence<T::dense_rows ? T::all_stages - T::stages - 1 : 0>{});
    const double *f0 = k_[0], *f1 = k_[kEnd];
    for (std::int64_t i = 0; i < n; ++i) {
      const double difference = y_[i] - y_old_[i];
      F[i] = difference;
      F[n + i] = h * f0[i] - difference;
      F[2 * n + i] = 2.0 * difference - h * (f0[i] + f1[i]);
    }
    own_dense_rows(h, F + 3 * n, std::make_index_sequence<T::dense_rows>{});
  }

 private:
  // Row of k that holds f at the end of the step.
  static constexpr int kEnd = T::stages;
  static constexpr std::size_t kRows = T::all_stages > T::stages ? T::all_stages : T::stages + 1;
  using Stages = std::array<double*, kRows>;

  void evaluate(double t, const double* y, double* dydt) {
    ++evaluations_;
    if constexpr (requires { Sys::kSize; }) {
      system_.eval(t, y, dydt);
    } else {
      system_.rhs(t, y, dydt);
    }
  }

  // k[1..stages) and y_out = y + h sum b_i k_i, from k[0]; false if y_out is not finite.
  bool stages(double t, double h, const double* y, const Stages& k, double* y_out) {
    if constexpr (is_small()) {
      constexpr int n = Sys::kSize;
      double y_here[n], y_next[n], k_here[T::stages][n];
      std::copy_n(y, n, y_here);
      std::copy_n(k[0], n, k_here[0]);
      const auto f = [this](double at, const double* w, double* dydt)
                         __attribute__((always_inline)) { system_.eval(at, w, dydt); };
      unrolled_step<T>(t, h, y_here, k_here, y_next, f);
      evaluations_ += T::stages - 1;
      for (int s = 1; s < T::stages; ++s) std::copy_n(k_here[s], n, k[usize(s)]);
      std::copy_n(y_next, n, y_out);
    } else {
      stages_from<1>(t, h, y, k, y_out);
    }
    return all_finite(y_out, size());
  }
  static constexpr bool is_small() {
    if constexpr (requires { Sys::kSize; }) {
      return Sys::kSize <= 8;
    } else {
      return false;
    }
  }
  template <int S>
  void stages_from(double t, double h, const double* y, const Stages& k, double* y_out) {
    const std::int64_t n = size();
    if constexpr (S < T::stages) {
      double* w = stage_;
#pragma GCC ivdep
      for (std::int64_t i = 0; i < n; ++i) w[i] = increment<StageRow<T, S>>(y[i], h, k, i);
      evaluate(t + T::c[S] * h, w, k[S]);
      stages_from<S + 1>(t, h, y, k, y_out);
    } else {
#pragma GCC ivdep
      for (std::int64_t i = 0; i < n; ++i) y_out[i] = increment<WeightRow<T>>(y[i], h, k, i);
    }
  }

  void fixed_step() {
    const double h = grid_.length(steps_, t_);
    if (!stages(t_, h, y_, k_, y_new_)) throw not_finite(h);
    accept(grid_.time(steps_ + 1));
  }

  void adaptive_step() {
    const double smallest = smallest_step(t_, direction_);
    constexpr double exponent = -1.0 / (error_order() + 1);
    double h_abs = h_abs_ > max_step_ ? max_step_ : std::max(h_abs_, smallest);
    double error = 1.0;
    bool rejected = false;
    if (!all_finite(k_[0], size())) throw not_finite(0.0);
    for (;;) {
      if (h_abs < smallest) {
        if (std::isnan(error)) throw not_finite(direction_ * h_abs);
        throw step_too_small(t_, steps_);
      }
      double t_new = t_ + direction_ * h_abs;
      if (direction_ * (t_new - t_bound_) > 0.0) t_new = t_bound_;
      const double h = t_new - t_;
      h_abs = std::fabs(h);
      error = attempt(h);
      if (error < 1.0) {
        h_abs_ = h_abs * grow_factor(error, exponent, rejected);
        accept(t_new);
        // f there serves the next step and the dense output; RK45 has it already.
        if constexpr (T::estimate == Estimate::embedded) have_end_ = true;
        return;
      }
      h_abs *= shrink_factor(error, exponent);
      rejected = true;
    }
  }

  static constexpr int error_order() {
    if constexpr (kDoubling) {
      return T::order;
    } else {
      return T::error_order;
    }
  }

  // y_new_ after a step h and the norm of its error; NaN where something is not finite.
  double attempt(double h) {
    if constexpr (kDoubling) {
      return attempt_doubled(h);
    } else {
      const double components = static_cast<double>(complex_pairs_ ? size() / 2 : size());
      if (!stages(t_, h, y_, k_, y_new_)) return std::nan("");
      if constexpr (T::estimate == Estimate::embedded) {
        evaluate(t_ + h, y_new_, k_[kEnd]);
        const auto squares = error_squares<1>(
            [&](std::int64_t i) { return std::array{weighted_sum<EmbeddedRow<T>>(k_, i)}; });
        return std::fabs(h) * std::sqrt(squares[0] / components);
      } else {
        // [HNW] II.10 (10.17): err = h e5^2 / sqrt(e5^2 + 0.01 e3^2)
        const auto squares = error_squares<2>([&](std::int64_t i) {
          return std::array{weighted_sum<FifthOrderRow<T>>(k_, i),
                            weighted_sum<ThirdOrderRow<T>>(k_, i)};
        });
        if (squares[0] == 0.0 && squares[1] == 0.0) return 0.0;
        return std::fabs(h) * squares[0] / std::sqrt((squares[0] + 0.01 * squares[1]) * components);
      }
    }
  }

  // Step doubling, [HNW] II.4 (4.4): the error of two half steps is (y_2 - y_whole) / (2^p - 1);
  // with it added, (4.5), the result is of order p + 1.
  double attempt_doubled(double h) {
    const double half = 0.5 * h;
    if (!stages(t_, h, y_, k_, y_whole_) || !stages(t_, half, y_, k_, y_half_)) {
      return std::nan("");
    }
    evaluate(t_ + half, y_half_, k_half_);
    Stages k = k_;
    k[0] = k_half_;
    if (!stages(t_ + half, half, y_half_, k, y_new_)) return std::nan("");
    constexpr double weight = 1.0 / ((1 << T::order) - 1);
    const double squares = scaled_squares_of_difference(tolerance_, complex_pairs_, size(), y_,
                                                        y_new_, y_whole_, weight);
    if (local_extrapolation_) {
      for (std::int64_t i = 0; i < size(); ++i) y_new_[i] += weight * (y_new_[i] - y_whole_[i]);
    }
    return std::sqrt(squares / static_cast<double>(complex_pairs_ ? size() / 2 : size()));
  }

  // Of few components the errors are made first: their sum is then the same code for all.
  template <std::size_t M, class Error>
  std::array<double, M> error_squares(Error&& error) const {
    if constexpr (is_small()) {
      double e[M][Sys::kSize];
      std::array<const double*, M> rows;
      for (std::int64_t i = 0; i < size(); ++i) {
        const std::array<double, M> errors = error(i);
        for (std::size_t m = 0; m < M; ++m) e[m][i] = errors[m];
      }
      for (std::size_t m = 0; m < M; ++m) rows[m] = e[m];
      return scaled_squares_of_rows<M>(tolerance_, complex_pairs_, size(), y_, y_new_, rows);
    } else {
      return scaled_squares<M>(tolerance_, complex_pairs_, size(), y_, y_new_, error);
    }
  }

  double first_step() {
    const double *f0 = k_[kEnd], *y = y_;
    return starting_step(tolerance_, complex_pairs_, size(), y, f0, std::fabs(t_bound_ - t_),
                         max_step_, error_order(), [&](double h0) {
                           for (std::int64_t i = 0; i < size(); ++i)
                             stage_[i] = y[i] + direction_ * h0 * f0[i];
                           evaluate(t_ + direction_ * h0, stage_, y_new_);
                           return y_new_;
                         });
  }

  void accept(double t_new) {
    std::swap(y_old_, y_);
    std::swap(y_, y_new_);
    t_old_ = t_;
    t_ = t_new;
    ++steps_;
  }

  template <std::size_t... S>
  void extra_stages([[maybe_unused]] double h, std::index_sequence<S...>) {
    (extra_stage<T::stages + 1 + static_cast<int>(S)>(h), ...);
  }
  template <int S>
  void extra_stage(double h) {
    for (std::int64_t i = 0; i < size(); ++i) {
      stage_[i] = increment<StageRow<T, S>>(y_old_[i], h, k_, i);
    }
    evaluate(t_old_ + T::c[S] * h, stage_, k_[S]);
  }

  template <std::size_t... R>
  void own_dense_rows([[maybe_unused]] double h, [[maybe_unused]] double* F,
                      std::index_sequence<R...>) {
    const std::int64_t n = size();
    for (std::int64_t i = 0; i < n; ++i) {
      ((F[static_cast<std::int64_t>(R) * n + i] = h * weighted_sum<DenseRow<T, R>>(k_, i)), ...);
    }
  }

  NonFiniteError not_finite(double h) const {
    constexpr int rows = T::stages + (T::estimate == Estimate::embedded ? 1 : 0);
    return stage_not_finite({T::name, T::stages, {T::c, T::stages}, {k_.data(), rows}}, size(),
                            complex_pairs_, y_new_, t_, h, steps_);
  }

  Sys& system_;
  std::int64_t dynamic_size_;
  Tolerance tolerance_;
  bool fixed_, complex_pairs_, local_extrapolation_;
  int threads_;
  double h_abs_, max_step_, direction_ = 1.0;
  FixedGrid grid_;
  bool started_ = false, have_end_ = false;
  struct Free {
    void operator()(double* memory) const { std::free(memory); }
  };
  std::unique_ptr<double, Free> memory_;
  double *y_, *y_old_, *y_new_, *stage_, *y_whole_ = nullptr, *y_half_ = nullptr,
                                         *k_half_ = nullptr;
  Stages k_{};
};

// The stepper of a method of the list, compiled for the type of the system; none for other names.
template <class List, class Sys>
std::unique_ptr<Stepper> make_runge_kutta(std::string_view method, Sys& system,
                                          const StepOptions& options) {
  std::unique_ptr<Stepper> stepper;
  const auto match = [&]<class T>(const T&) {
    if (T::name == method) stepper = std::make_unique<RungeKutta<T, Sys>>(system, options);
  };
  std::apply([&](const auto&... t) { (match(t), ...); }, List{});
  return stepper;
}

}  // namespace substep::ode
