// Step size control: tolerances, weighted norms, the first step, the next step.
// [HNW] Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", 2nd ed., II.4.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace substep::ode {

// Constants of [HNW] II.4 as SciPy takes them, so that errors at equal tolerances compare.
constexpr double kSafety = 0.9, kMinFactor = 0.2, kMaxFactor = 10.0;

// rtol and atol: one number for all components, or one per component.
class Tolerance {
 public:
  Tolerance(std::vector<double> rtol, std::vector<double> atol, std::int64_t components)
      : rtol_(std::move(rtol)), atol_(std::move(atol)) {
    uniform_ = rtol_.size() == 1 && atol_.size() == 1;
    if (uniform_) return;
    const auto n = usize(components);
    if (rtol_.size() == 1) rtol_.assign(n, rtol_[0]);
    if (atol_.size() == 1) atol_.assign(n, atol_[0]);
  }

  // Calls use(scale) with scale(i, |y_i|) = atol_i + rtol_i |y_i|, above 0 even where both are 0.
  template <class Use>
  auto with_scale(Use&& use) const {
    if (uniform_) {
      const double rtol = rtol_[0], atol = atol_[0];
      return use([=](std::int64_t, double size) { return atol + rtol * size + kTiny; });
    }
    const double *rtol = rtol_.data(), *atol = atol_.data();
    return use([=](std::int64_t i, double size) { return atol[i] + rtol[i] * size + kTiny; });
  }

 private:
  static constexpr double kTiny = std::numeric_limits<double>::min();
  std::vector<double> rtol_, atol_;
  bool uniform_;
};

// Sums of `M` terms over i in [0, n), in a fixed order: eight lanes, or one after the other where
// that would not fill them.
template <std::size_t M, class Terms>
std::array<double, M> sums(std::int64_t n, Terms&& terms) {
  constexpr std::int64_t kLanes = 8;
  std::array<double, M> total{};
  if (n < kLanes) {
    for (std::int64_t i = 0; i < n; ++i) {
      const std::array<double, M> term = terms(i);
      for (std::size_t m = 0; m < M; ++m) total[m] += term[m];
    }
    return total;
  }
  double lane[M][kLanes] = {};
  std::int64_t i = 0;
  for (; i + kLanes <= n; i += kLanes) {
#pragma GCC ivdep
    for (std::int64_t l = 0; l < kLanes; ++l) {
      const std::array<double, M> term = terms(i + l);
      for (std::size_t m = 0; m < M; ++m) lane[m][l] += term[m];
    }
  }
  for (std::int64_t l = 0; i < n; ++i, ++l) {
    const std::array<double, M> term = terms(i);
    for (std::size_t m = 0; m < M; ++m) lane[m][l] += term[m];
  }
  for (std::size_t m = 0; m < M; ++m) {
    for (double value : lane[m]) total[m] += value;
  }
  return total;
}

// Sums over the components of (|e_m| / scale)^2, scale = atol + rtol max(|y|, |y_new|); e(i)
// returns M numbers. With complex pairs a component is a pair and |.| its modulus.
template <std::size_t M, class Error>
std::array<double, M> scaled_squares(const Tolerance& tolerance, bool complex_pairs, std::int64_t n,
                                     const double* y, const double* y_new, Error&& e) {
  return tolerance.with_scale([&](auto&& scale) {
    if (complex_pairs) {
      return sums<M>(n / 2, [&](std::int64_t i) {
        const double size = std::max(std::hypot(y[2 * i], y[2 * i + 1]),
                                     std::hypot(y_new[2 * i], y_new[2 * i + 1]));
        const double inverse = 1.0 / scale(i, size);
        const std::array<double, M> re = e(2 * i), im = e(2 * i + 1);
        std::array<double, M> term;
        for (std::size_t m = 0; m < M; ++m) {
          term[m] = (re[m] * re[m] + im[m] * im[m]) * inverse * inverse;
        }
        return term;
      });
    }
    return sums<M>(n, [&](std::int64_t i) {
      const double a = std::fabs(y[i]), b = std::fabs(y_new[i]);
      const double inverse = 1.0 / scale(i, a > b ? a : b);
      const std::array<double, M> error = e(i);
      std::array<double, M> term;
      for (std::size_t m = 0; m < M; ++m) term[m] = error[m] * inverse * (error[m] * inverse);
      return term;
    });
  });
}

// The same of errors that stand in rows, M = 1 or 2, and of weight (y_new - other).
template <std::size_t M>
std::array<double, M> scaled_squares_of_rows(const Tolerance& tolerance, bool complex_pairs,
                                             std::int64_t n, const double* y, const double* y_new,
                                             const std::array<const double*, M>& e);
double scaled_squares_of_difference(const Tolerance& tolerance, bool complex_pairs, std::int64_t n,
                                    const double* y, const double* y_new, const double* other,
                                    double weight);

// The first step, [HNW] II.4, "Starting Step Size"; f0 = f(t, y), and f1_after(h0) returns f after
// a step h0 of Euler's method.
double starting_step(const Tolerance& tolerance, bool complex_pairs, std::int64_t n,
                     const double* y, const double* f0, double span, double max_step,
                     int error_order, const std::function<const double*(double h0)>& f1_after);

// Factor for the next step after an error norm below 1, [HNW] (4.13); NaN shrinks.
inline double grow_factor(double error, double exponent, bool rejected_before) {
  const double factor =
      error == 0.0 ? kMaxFactor : std::min(kMaxFactor, kSafety * std::pow(error, exponent));
  return rejected_before ? std::min(1.0, factor) : factor;
}
inline double shrink_factor(double error, double exponent) {
  const double factor = kSafety * std::pow(error, exponent);
  return factor > kMinFactor ? factor : kMinFactor;
}

// A number as messages show it.
inline std::string format(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.10g", value);
  return text;
}

// How steps fail: no step is short enough; stage `stage` brought what is not finite.
SolverError step_too_small(double t, std::int64_t steps);
NonFiniteError not_finite_in_step(const char* what, double t, std::int64_t component, int stage,
                                  std::string_view method, std::int64_t steps, double last_good_t);

// Steps below ten spacings of t have lost their meaning.
inline double smallest_step(double t, double direction) {
  const double inf = std::numeric_limits<double>::infinity();
  return 10.0 * std::fabs(std::nextafter(t, direction * inf) - t);
}

}  // namespace substep::ode
