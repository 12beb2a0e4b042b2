// The formulas of RKC2, the Runge-Kutta-Chebyshev method of order 2, for s stages.
//
//   y_1 = y_0 + mu~_1 h f_0
//   y_j = (1 - mu_j - nu_j) y_0 + mu_j y_{j-1} + nu_j y_{j-2} + mu~_j h f_{j-1} + gamma~_j h f_0
//
// with f_j = f(t + c_j h, y_j), j = 2 .. s; y_s is the result. [SSV] Sommeijer, Shampine, Verwer,
// "RKC: an explicit solver for parabolic PDEs", J. Comput. Appl. Math. 88 (1998) 315-326, section
// 2; c_j follows from y' = 1. Its stability function is that of a damped Chebyshev polynomial,
//
//   R_s(z) = a_s + b_s T_s(w_0 + w_1 z),    |R_s| <= 1 - epsilon / 3 on [-beta(s), 0] but near 0,
//   beta(s) = (w_0 + 1) T_s''(w_0) / T_s'(w_0) ~ 2/3 (s^2 - 1) (1 - 2/15 epsilon).
#pragma once

#include <cmath>
#include <vector>

#include "substep/core/usize.h"

namespace substep::ode {

class RkcFormula {
 public:
  static constexpr double kEpsilon = 2.0 / 13.0;  // damping, [SSV] section 2

  struct Stage {
    double mu, nu, mu_tilde, gamma_tilde, c;
  };

  explicit RkcFormula(int stages) : stages_(stages), stage_(usize(stages) + 1) {
    w0_ = 1.0 + kEpsilon / (static_cast<double>(stages) * stages);
    Chebyshev last = at_one();
    for (int j = 2; j <= stages; ++j) last = next(last);
    w1_ = last.dT / last.d2T;
    // b_j = T_j''(w_0) / T_j'(w_0)^2, b_0 = b_1 = b_2; a_j = 1 - b_j T_j(w_0).
    Chebyshev here = next(at_one());
    double b_before = here.d2T / (here.dT * here.dT), b = b_before;
    double a = 1.0 - b * w0_;
    stage_[0] = {0.0, 0.0, 0.0, 0.0, 0.0};
    stage_[1] = {0.0, 0.0, b * w1_, 0.0, b * w1_};
    for (int j = 2; j <= stages; ++j) {
      if (j > 2) here = next(here);
      const double b_j = here.d2T / (here.dT * here.dT);
      Stage& s = stage_[usize(j)];
      s.mu = 2.0 * b_j * w0_ / b;
      s.nu = -b_j / b_before;
      s.mu_tilde = 2.0 * b_j * w1_ / b;
      s.gamma_tilde = -a * s.mu_tilde;
      s.c = s.mu * stage(j - 1).c + s.nu * stage(j - 2).c + s.mu_tilde + s.gamma_tilde;
      a = 1.0 - b_j * here.T;
      b_before = b;
      b = b_j;
    }
    a_ = a;
    b_ = b;
  }

  int stages() const { return stages_; }
  const Stage& stage(int j) const { return stage_[usize(j)]; }
  double w0() const { return w0_; }
  double w1() const { return w1_; }
  double a() const { return a_; }  // a_s
  double b() const { return b_; }  // b_s

  // Stages for h lambda in [-x, 0], and the x that s stages reach: [SSV], rkclow, from beta(s) at
  // epsilon = 2/13.
  static double stages_for(double x) { return 1.0 + std::floor(std::sqrt(1.0 + kPerReach * x)); }
  static double reach(double stages) { return (stages * stages - 1.0) / kPerReach; }

 private:
  static constexpr double kPerReach = 1.54;

  struct Chebyshev {  // T_j, T_j' and T_j'' at w_0, and those of j - 1
    double T, dT, d2T, T_1, dT_1, d2T_1;
  };
  Chebyshev at_one() const { return {w0_, 1.0, 0.0, 1.0, 0.0, 0.0}; }
  Chebyshev next(const Chebyshev& j) const {
    return {2.0 * w0_ * j.T - j.T_1,
            2.0 * j.T + 2.0 * w0_ * j.dT - j.dT_1,
            4.0 * j.dT + 2.0 * w0_ * j.d2T - j.d2T_1,
            j.T,
            j.dT,
            j.d2T};
  }

  int stages_;
  double w0_, w1_, a_, b_;
  std::vector<Stage> stage_;
};

}  // namespace substep::ode
