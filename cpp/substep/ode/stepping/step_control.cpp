#include "substep/ode/stepping/step_control.h"

namespace substep::ode {
namespace {

// The root mean square of value(i) / scale, scale = atol + rtol |y|.
template <class Value>
double scaled_norm(const Tolerance& tolerance, bool complex_pairs, std::int64_t n, const double* y,
                   Value&& value) {
  const auto squares = scaled_squares<1>(tolerance, complex_pairs, n, y, y, [&](std::int64_t i) {
    return std::array<double, 1>{value(i)};
  });
  return std::sqrt(squares[0] / static_cast<double>(complex_pairs ? n / 2 : n));
}

}  // namespace

template <std::size_t M>
std::array<double, M> scaled_squares_of_rows(const Tolerance& tolerance, bool complex_pairs,
                                             std::int64_t n, const double* y, const double* y_new,
                                             const std::array<const double*, M>& e) {
  return scaled_squares<M>(tolerance, complex_pairs, n, y, y_new, [&](std::int64_t i) {
    std::array<double, M> errors;
    for (std::size_t m = 0; m < M; ++m) errors[m] = e[m][i];
    return errors;
  });
}

double scaled_squares_of_difference(const Tolerance& tolerance, bool complex_pairs, std::int64_t n,
                                    const double* y, const double* y_new, const double* other,
                                    double weight) {
  return scaled_squares<1>(tolerance, complex_pairs, n, y, y_new, [=](std::int64_t i) {
    return std::array{weight * (y_new[i] - other[i])};
  })[0];
}

double starting_step(const Tolerance& tolerance, bool complex_pairs, std::int64_t n,
                     const double* y, const double* f0, double span, double max_step,
                     int error_order, const std::function<const double*(double h0)>& f1_after) {
  const auto norm = [&](auto&& value) {
    return scaled_norm(tolerance, complex_pairs, n, y, value);
  };
  const double d0 = norm([&](std::int64_t i) { return y[i]; });
  const double d1 = norm([&](std::int64_t i) { return f0[i]; });
  double h0 = d0 < 1e-5 || d1 < 1e-5 ? 1e-6 : 0.01 * d0 / d1;
  h0 = std::min(h0, span);
  const double* f1 = f1_after(h0);
  const double d2 = norm([&](std::int64_t i) { return f1[i] - f0[i]; }) / h0;
  const double h1 = d1 <= 1e-15 && d2 <= 1e-15
                        ? std::max(1e-6, h0 * 1e-3)
                        : std::pow(0.01 / std::max(d1, d2), 1.0 / (error_order + 1));
  return std::min({100.0 * h0, h1, span, max_step});
}

SolverError step_too_small(double t, std::int64_t steps) {
  return SolverError("step below spacing of t at t = " + format(t) +
                         ": the solution may end here, or max_step or the tolerances are too "
                         "small",
                     t, -1, steps);
}

NonFiniteError not_finite_in_step(const char* what, double t, std::int64_t component, int stage,
                                  std::string_view method, std::int64_t steps, double last_good_t) {
  return NonFiniteError(std::string(what) + " became NaN or infinite at t = " + format(t) +
                            ", component " + std::to_string(component) + ", stage " +
                            std::to_string(stage) + " of " + std::string(method) + ", step " +
                            std::to_string(steps) + "; last good t = " + format(last_good_t),
                        t, component, steps);
}

template std::array<double, 1> scaled_squares_of_rows(const Tolerance&, bool, std::int64_t,
                                                      const double*, const double*,
                                                      const std::array<const double*, 1>&);
template std::array<double, 2> scaled_squares_of_rows(const Tolerance&, bool, std::int64_t,
                                                      const double*, const double*,
                                                      const std::array<const double*, 2>&);

}  // namespace substep::ode
