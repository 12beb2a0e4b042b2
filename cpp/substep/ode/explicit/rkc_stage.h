// A stage of RKC2 as a system with a kernel of its own sees it.
#pragma once

#include "substep/ode/stepping/combine.h"

namespace substep::ode {

// y_j = rest y_0 + mu y_{j-1} + nu y_{j-2} + mu_h f(t, y_{j-1}) + gamma_h f_0, (rkc_formula.h); y_j
// takes the place of y_{j-2}.
struct RkcStage {
  double t;
  double rest, mu, nu, mu_h, gamma_h;
  const double *y0, *f0;
  const double* y1;  // y_{j-1}
  double* y2;        // y_{j-2}, then y_j
  int threads;       // 0: default

  // Component i of y_j; f is that of f(t, y_{j-1}).
  [[gnu::always_inline]] double sum(std::int64_t i, double f) const {
    const double early = multiply_add(rest, y0[i], gamma_h * f0[i]);
    const double late = multiply_add(mu, y1[i], nu * y2[i]);
    return multiply_add(mu_h, f, early + late);
  }
};

}  // namespace substep::ode
