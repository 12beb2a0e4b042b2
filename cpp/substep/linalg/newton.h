// Damped Newton for a minimum of E(x) or a root of F(x) (Nocedal, Wright, "Numerical Optimization",
// 2nd ed., algorithms 3.1 and 11.4).
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "substep/core/interrupt.h"

namespace substep {

// What is solved. For a minimum: merit E, gradient g = grad E. For a root: merit |F|^2 / 2,
// gradient g = F.
//   merit(x)                       the number that the line search brings down; NaN, infinity: too
//   far gradient(x, g) residual(g)                    in the units of the stop rule: converged at
//   <= 1 direction(x, g, forcing, d)    solves H d = -g to |H d + g| <= forcing |g| (0: exactly)
//   and
//                                  returns the slope of the merit along d, which is to be negative:
//                                  g . d for a minimum, -2 merit for a root
//   step_limit(x, d)               optional: no step beyond this fraction of d, at most 1 is tried
//   rounding()                     optional: what the merit is good to, where that is more than its
//                                  own rounding
template <class P>
concept NewtonProblem = requires(P p, std::span<const double> in, std::span<double> out) {
  { p.merit(in) } -> std::convertible_to<double>;
  p.gradient(in, out);
  { p.residual(in) } -> std::convertible_to<double>;
  { p.direction(in, in, 0.0, out) } -> std::convertible_to<double>;
};

struct NewtonOptions {
  std::int32_t max_iterations = 50;
  std::int32_t max_halvings = 30;  // of one line search
  double armijo = 1e-4;            // share of the predicted decrease that is asked for (eq. 3.4)
  double max_forcing = 0;          // of inexact solves; 0: all are exact
};

struct NewtonReport {
  bool converged = false;
  std::int32_t iterations = 0;
  std::int32_t halvings = 0;
  std::vector<double> residuals;  // before and after each iteration, in units of the stop rule
  std::string remedy;             // what to try where it did not converge
};

// x is the first guess and becomes the answer, or the best iterate. Where it did not converge, the
// report says so; problems throw what they meet.
template <NewtonProblem P>
NewtonReport newton(P&& problem, std::span<double> x, const NewtonOptions& options = {}) {
  const std::size_t n = x.size();
  std::vector<double> g(n), d(n), trial(n);
  NewtonReport report;
  double merit = problem.merit(x);
  double forcing = options.max_forcing;
  for (;;) {
    poll_interrupt();
    problem.gradient(x, g);
    report.residuals.push_back(problem.residual(g));
    const double residual = report.residuals.back();
    report.converged = residual <= 1;
    if (report.converged) return report;
    if (report.iterations >= options.max_iterations) {
      report.remedy = "allow more iterations, or take a smaller step";
      return report;
    }
    if (options.max_forcing > 0 && report.iterations > 0) {
      // Eisenstat, Walker, SIAM J. Sci. Comput. 17 (1996) 16, choice 2 with gamma = 0.9.
      const double ratio = residual / report.residuals[report.residuals.size() - 2];
      forcing = std::clamp(0.9 * ratio * ratio, 1e-10, options.max_forcing);
    }
    const double slope = problem.direction(x, g, forcing, d);
    if (!(slope < 0)) {
      report.remedy = "the direction does not descend: project the Hessian, or check the Jacobian";
      return report;
    }
    double step = 1;
    if constexpr (requires { problem.step_limit(x, d); }) {
      step = std::min(step, static_cast<double>(problem.step_limit(x, d)));
    }
    // Differences below the rounding of the merit decide nothing.
    double rounding = 1e-14 * std::abs(merit);
    if constexpr (requires { problem.rounding(); }) {
      rounding = std::max(rounding, static_cast<double>(problem.rounding()));
    }
    for (std::int32_t halving = 0;; ++halving) {
      for (std::size_t i = 0; i < n; ++i) trial[i] = x[i] + step * d[i];
      const double next = problem.merit(trial);
      if (next <= merit + options.armijo * step * slope + rounding) {
        merit = next;
        break;
      }
      if (halving == options.max_halvings) {
        report.remedy = "no step along the direction descends: take a smaller time step";
        return report;
      }
      ++report.halvings;
      step /= 2;
    }
    std::copy(trial.begin(), trial.end(), x.begin());
    ++report.iterations;
  }
}

}  // namespace substep
