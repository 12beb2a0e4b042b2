#include "substep/springs/newton_minimiser.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"

namespace substep::springs {
namespace {

constexpr double kArmijo = 1e-4;     // of the slope: the fall that a step has to bring
constexpr double kRounding = 1e-13;  // of the energy: what its sum is good to
constexpr int kMaxBacktracks = 40;
constexpr int kMaxDoublings = 8;
constexpr double kLeastKept = 0.2;  // of the negative curvature; below that none is kept

double dot(std::span<const Vec3> a, std::span<const Vec3> b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i].dot(b[i]);
  return sum;
}

}  // namespace

// Factorizes the Hessian with as much of its negative curvature as leaves it positive definite.
// What was kept is a guess for the next time: in most steps all of it can be kept in the end, and
// then the convergence is quadratic.
bool NewtonMinimiser::factorize(IncrementalPotential& energy, std::span<const Vec3> x,
                                MinimiserReport& report) {
  for (kept_ = next_kept_;; kept_ = kept_ > kLeastKept ? kept_ / 2 : 0.0) {
    energy.assemble(x, kept_, g_, values_);
    ++report.factorizations;
    if (cholesky_->factorize(values_, energy.threads()) < 0) break;
    if (kept_ == 0.0) return false;
  }
  next_kept_ = std::min(1.0, std::max(1.5 * kept_, kLeastKept));
  return true;
}

// Accepts the trial, which is x + dx.
void NewtonMinimiser::accept(IncrementalPotential& energy, std::span<Vec3> x) {
  energy.follow(x, dx_);
  std::copy(trial_.begin(), trial_.end(), x.begin());
}

MinimiserReport NewtonMinimiser::minimise(IncrementalPotential& energy, std::span<Vec3> x,
                                          double tolerance) {
  const std::size_t n = x.size();
  const BlockPattern& pattern = energy.pattern();
  if (!cholesky_) {
    const auto size = static_cast<std::int32_t>(3 * n);
    cholesky_ = std::make_unique<SupernodalCholesky>(
        SparsePattern{size, size, pattern.columns, pattern.rows}, 3);
  }
  values_.resize(pattern.rows.size());
  g_.resize(n);
  dx_.resize(n);
  trial_.resize(n);
  next_kept_ = 1.0;
  MinimiserReport report;
  double level = energy.energy(x);
  for (;; ++report.iterations) {
    poll_interrupt();
    energy.gradient(x, g_);
    report.residuals.push_back(largest_component(g_));
    report.converged = report.residuals.back() <= tolerance;
    if (report.converged || report.iterations == max_iterations_ ||
        !std::isfinite(report.residuals.back()) || !factorize(energy, x, report)) {
      return report;
    }
    for (std::size_t i = 0; i < n; ++i) dx_[i] = -g_[i];
    cholesky_->solve(std::span(dx_[0].data(), 3 * n), energy.threads());

    const double slope = dot(g_, dx_);
    const double rounding = kRounding * std::abs(level) + energy.energy_rounding(x);
    double s = energy.step_bound(x, dx_);
    for (int tried = 0;; ++tried, s /= 2) {
      for (std::size_t i = 0; i < n; ++i) trial_[i] = x[i] + s * dx_[i];
      const double next = energy.energy(trial_);
      if (next <= level + kArmijo * s * slope + rounding) {
        level = next;
        break;
      }
      if (tried == kMaxBacktracks) return report;
      ++report.backtracks;
    }
    if (s < 1.0) {  // what was foreseen did not come: forces are taken as they are
      std::copy(trial_.begin(), trial_.end(), x.begin());
      std::fill(dx_.begin(), dx_.end(), Vec3::Zero());
      energy.follow(x, dx_);
      continue;
    }
    accept(energy, x);
    for (int doubled = 0; kept_ < 1.0 && doubled < kMaxDoublings; ++doubled) {
      if (energy.step_bound(x, dx_) < 1.0) break;
      for (std::size_t i = 0; i < n; ++i) trial_[i] = x[i] + dx_[i];
      const double next = energy.energy(trial_);
      if (!(next < level - rounding)) break;
      level = next;
      accept(energy, x);
      for (Vec3& d : dx_) d *= 2.0;
    }
  }
}

}  // namespace substep::springs
