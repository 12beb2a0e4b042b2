#include "substep/ode/explicit/runge_kutta.h"

#include "substep/core/usize.h"

namespace substep::ode {

NonFiniteError stage_not_finite(const FailedStages& failed, std::int64_t n, bool complex_pairs,
                                const double* y_new, double t, double h, std::int64_t steps) {
  const auto error = [&](const char* what, double at, std::int64_t i, int stage) {
    return not_finite_in_step(what, at, complex_pairs ? i / 2 : i, stage, failed.method, steps, t);
  };
  for (int s = 0; s < static_cast<int>(failed.k.size()); ++s) {
    const auto row = usize(s);
    for (std::int64_t i = 0; i < n; ++i) {
      if (std::isfinite(failed.k[row][i])) continue;
      return error("the derivative", t + (s < failed.stages ? failed.c[row] : 1.0) * h, i, s + 1);
    }
    if (h == 0.0) break;
  }
  for (std::int64_t i = 0; i < n; ++i) {
    if (!std::isfinite(y_new[i])) return error("the state", t + h, i, failed.stages);
  }
  return error("the derivative", t + 0.5 * h, 0, 1);
}

}  // namespace substep::ode
