#include "substep/ode/explicit/spectral_radius.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/core/interrupt.h"
#include "substep/core/random.h"
#include "substep/core/usize.h"
#include "substep/ode/stepping/step_control.h"

namespace substep::ode {
namespace {

constexpr int kIterations = 50;
constexpr double kBeyond = 1.2, kConverged = 0.01;

template <class Value>
double norm(std::int64_t n, Value&& value) {
  const auto squares = sums<1>(n, [&](std::int64_t i) {
    const double v = value(i);
    return std::array<double, 1>{v * v};
  });
  return std::sqrt(squares[0]);
}

}  // namespace

double SpectralRadius::at(double t, const double* y, const double* f, std::int64_t step) {
  const bool new_time = step_ < 0 || t != time_;
  if (!new_time) return value_;
  if (given_) {
    value_ = given_(t, y);
    if (!(value_ >= 0.0 && std::isfinite(value_))) {
      throw InputError("spectral_radius: expected a finite number of at least 0, got " +
                       format(value_) + " at t = " + format(t));
    }
  } else if (const double known = system_.spectral_radius(t, y); known >= 0.0) {
    value_ = known;
  } else if (step_ < 0 || stale_ || step - step_ >= steps_of_estimate_) {
    value_ = estimate(t, y, f);
  } else {
    return value_;
  }
  time_ = t;
  step_ = step;
  stale_ = false;
  return value_;
}

// The direction to begin with: the last one, or else that of f, which is rich in fast modes after a
// step, [SSV], rkcrho. Beyond [SSV], random signs are mixed in: f may lie among the slow modes
// (a smooth solution of the heat equation), and another mode may have become the fastest.
void SpectralRadius::choose_direction(const double* f) {
  const std::int64_t n = system_.size();
  const bool first = direction_.empty();
  if (first) direction_.assign(f, f + n);
  const double length = norm(n, [&](std::int64_t i) { return direction_[i]; });
  const bool usable = length > 0.0 && std::isfinite(length);
  const double noise = (first ? 1.0 : 0.1) / std::sqrt(static_cast<double>(n));
  for (std::int64_t i = 0; i < n; ++i) {
    const auto bits = philox({static_cast<std::uint32_t>(i), static_cast<std::uint32_t>(i >> 32),
                              static_cast<std::uint32_t>(estimates_), 0},
                             {0, 0});
    const double old = usable ? direction_[i] / length : 0.0;
    direction_[i] = old + (bits[0] & 1 ? noise : -noise);
  }
  ++estimates_;
}

// The nonlinear power method of [SSV], rkcrho: v <- y + d (f(v) - f(y)) / |f(v) - f(y)|, d the
// length of v - y, and sigma = |f(v) - f(y)| / d until it changes by less than 1 %; 1.2 sigma is
// taken for the bound. Where sigma does not settle, because complex eigenvalues lead, its product
// over k iterations still grows as rho^k, so that the greatest of many is not below rho.
double SpectralRadius::estimate(double t, const double* y, const double* f) {
  const std::int64_t n = system_.size();
  v_.resize(usize(n)), f_v_.resize(usize(n));
  choose_direction(f);
  constexpr double epsilon = std::numeric_limits<double>::epsilon();
  const double y_length = norm(n, [&](std::int64_t i) { return y[i]; });
  const double d = y_length > 0.0 ? y_length * std::sqrt(epsilon) : epsilon;
  double sigma = 0.0, greatest = 0.0;
  double length = norm(n, [&](std::int64_t i) { return direction_[i]; });
  for (int k = 0; k < kIterations; ++k) {
    poll_interrupt();
    for (std::int64_t i = 0; i < n; ++i) v_[i] = y[i] + direction_[i] * (d / length);
    system_.rhs(t, v_.data(), f_v_.data());
    ++evaluations_;
    const double change = norm(n, [&](std::int64_t i) { return f_v_[i] - f[i]; });
    const double before = std::exchange(sigma, change / d);
    if (!std::isfinite(sigma)) {  // v left the domain of f: the step will tell
      direction_.clear();
      return value_;
    }
    if (k >= kIterations / 2) greatest = std::max(greatest, sigma);
    if (change == 0.0) return 0.0;  // random signs do not lie among the eigenvectors of zero
    for (std::int64_t i = 0; i < n; ++i) direction_[i] = f_v_[i] - f[i];
    length = change;
    if (k > 0 && std::fabs(sigma - before) <= kConverged * std::max(sigma, slowest_)) {
      greatest = sigma;
      break;
    }
  }
  return kBeyond * greatest;
}

}  // namespace substep::ode
