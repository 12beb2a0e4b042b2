#include "substep/springs/newton_minimiser.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"
#include "substep/linalg/vectors.h"

namespace substep::springs {
namespace {

constexpr double kArmijo = 1e-4;     // of the slope: the fall that a step has to bring
constexpr double kRounding = 1e-13;  // of the energy: what its sum is good to
constexpr int kMaxBacktracks = 40;
constexpr double kLeastPart = 0.1;  // of a step, that a backtrack leaves; quasi-Newton: half
constexpr double kForcing = 1e-3;   // of the gradient: what a step of Newton's may leave of it
constexpr double kLeastKept = 0.2;  // of the negative curvature; below that none is kept
constexpr int kTrusted = 2;         // factorizations that pass in a row before more is kept

constexpr std::size_t kPairs = 10;    // of steps and gradients that quasi-Newton steps learn from
constexpr std::size_t kCarried = 5;   // pairs that still hold when the Hessian has changed little
constexpr int kMaxRefinements = 200;  // with one factorization
constexpr int kPatience = 8;          // of them in which the slope has not fallen
constexpr int kRefinementBacktracks = 2;

std::span<const double> numbers(Positions v) {
  return v.empty() ? std::span<const double>() : std::span(v[0].data(), 3 * v.size());
}

}  // namespace

NewtonMinimiser::NewtonMinimiser(int max_iterations)
    : max_iterations_(max_iterations), memory_(kPairs) {}

MinimiserReport NewtonMinimiser::minimise(IncrementalPotential& energy, std::span<Vec3> x,
                                          double tolerance) {
  MinimiserReport report;
  begin(energy, x);
  for (;; ++report.iterations) {
    poll_interrupt();
    energy.gradient(x, g_);
    report.residuals.push_back(largest_component(g_));
    report.converged = report.residuals.back() <= tolerance;
    if (report.converged || report.iterations == max_iterations_ ||
        !std::isfinite(report.residuals.back()) || !factorize(energy, x, report)) {
      return report;
    }
    const double slope = find_direction(energy, x, false);
    const double s = descend(energy, x, slope, kMaxBacktracks, kLeastPart, report);
    if (s == 0.0) return report;
    if (s == 1.0) {
      energy.follow(x_before_, dx_);
    } else {
      take_forces_as_they_are(energy, x);
    }
    if (kept_ < 1.0 || s < 1.0) {
      refine(energy, x, tolerance, report);
    } else {
      memory_.forget();
    }
  }
}

void NewtonMinimiser::begin(IncrementalPotential& energy, Positions x) {
  const BlockPattern& pattern = energy.pattern();
  if (!cholesky_) {
    const auto size = static_cast<std::int32_t>(3 * energy.vertices());
    cholesky_ = std::make_unique<BorderedCholesky>(
        SparsePattern{size, size, pattern.columns, pattern.rows});
  }
  cholesky_->forget();
  values_.resize(pattern.rows.size());
  for (auto* v : {&g_, &dx_, &trial_}) v->resize(x.size());
  memory_.forget();
  next_kept_ = 1.0;
  passed_ = 0;
  level_ = energy.energy(x);
  energy.arrive();
}

// Factorizes the Hessian with as much of its negative curvature as leaves it positive definite.
// What was kept is a guess for the next time: in most steps all of it can be kept in the end, and
// then the convergence is quadratic.
bool NewtonMinimiser::factorize(IncrementalPotential& energy, Positions x,
                                MinimiserReport& report) {
  ++passed_;
  for (kept_ = next_kept_;; kept_ = kept_ > kLeastKept ? kept_ / 2 : 0.0, passed_ = 0) {
    energy.assemble(x, kept_, g_, values_);
    ++report.factorizations;
    if (cholesky_->factorize(values_, energy.border(), energy.threads())) break;
    if (kept_ == 0.0) return false;
  }
  next_kept_ = passed_ < kTrusted ? kept_ : std::min(1.0, std::max(1.5 * kept_, kLeastKept));
  return true;
}

// dx = -H^-1 g by the factorization and, if `learned`, by what the memory adds to it. Where H is
// the true Hessian, up to kForcing: more digits of it would not help Newton's method, fewer would
// cost it iterations (Nocedal and Wright, section 7.1). Returns the slope g . dx.
double NewtonMinimiser::find_direction(const IncrementalPotential& energy, Positions x,
                                       bool learned) {
  const int threads = energy.threads();
  x_before_.assign(x.begin(), x.end());
  g_before_ = g_;
  for (std::size_t i = 0; i < g_.size(); ++i) dx_[i] = -g_[i];
  const auto factor_solve = [&](std::span<double> r) {
    cholesky_->solve(energy.border(), r, threads);
  };
  if (learned) {
    memory_.multiply(dx_, factor_solve, threads);
  } else if (!dx_.empty()) {
    const std::span<double> r(dx_[0].data(), 3 * dx_.size());
    // With less curvature the Hessian itself is worth no more than its factorization.
    if (kept_ < 1.0) {
      factor_solve(r);
    } else if (!cholesky_->solve(values_, energy.border(), r, kForcing, threads)) {
      kept_ = next_kept_ = 0.5;
      passed_ = 0;
    }
  }
  return dot(numbers(g_), numbers(dx_), threads);
}

// Goes along dx as far as the energy falls enough; where it does not, next to the minimum of the
// parabola through what is known (Nocedal and Wright, eq. 3.58). Returns the length of the step, 0
// without any.
double NewtonMinimiser::descend(IncrementalPotential& energy, std::span<Vec3> x, double slope,
                                int most_backtracks, double least_part, MinimiserReport& report) {
  const double rounding = kRounding * std::abs(level_) + energy.energy_rounding(x);
  double s = energy.step_bound(x, dx_);
  for (int tried = 0;; ++tried) {
    for (std::size_t i = 0; i < x.size(); ++i) trial_[i] = x[i] + s * dx_[i];
    const double next = energy.energy(trial_);
    if (next <= level_ + kArmijo * s * slope + rounding) {
      level_ = next;
      energy.arrive();
      break;
    }
    if (tried == most_backtracks) return 0.0;
    ++report.backtracks;
    const double part = -0.5 * s * slope / (next - level_ - s * slope);
    s *= std::isfinite(next) ? std::clamp(part, least_part, 0.5) : 0.5;
  }
  std::copy(trial_.begin(), trial_.end(), x.begin());
  return s;
}

// After a step that did not go as foreseen.
void NewtonMinimiser::take_forces_as_they_are(IncrementalPotential& energy, Positions x) {
  std::fill(dx_.begin(), dx_.end(), Vec3::Zero());
  energy.follow(x, dx_);
}

// Quasi-Newton steps with the factorization at hand, until they no longer pay: the energy does not
// fall, or the slope has not fallen for a while. In the first case the matrix is of the past, and
// so is the memory.
void NewtonMinimiser::refine(IncrementalPotential& energy, std::span<Vec3> x, double tolerance,
                             MinimiserReport& report) {
  double least = INFINITY;
  std::size_t carried = 0;
  int step = 0;
  for (int waited = 0;; ++step) {
    poll_interrupt();
    energy.gradient(x, g_);
    memory_.add(x_before_, x, g_before_, g_, energy.threads());
    if (largest_component(g_) <= tolerance || step == kMaxRefinements) break;
    const double slope = find_direction(energy, x, true);
    waited = -slope < least ? 0 : waited + 1;
    least = std::min(least, -slope);
    if (waited > kPatience) {
      carried = kCarried;
      break;
    }
    if (!(slope < 0.0) || descend(energy, x, slope, kRefinementBacktracks, 0.5, report) == 0.0)
      break;
    ++report.refinements;
  }
  if (step > 0) take_forces_as_they_are(energy, x);
  memory_.forget(carried);
}

}  // namespace substep::springs
