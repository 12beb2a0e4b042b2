#include "substep/springs/newton_minimiser.h"

#include <algorithm>
#include <cmath>

#include "substep/core/interrupt.h"

namespace substep::springs {
namespace {

constexpr double kArmijo = 1e-4;     // of the slope: the fall that a step has to bring
constexpr double kRounding = 1e-13;  // of the energy: what its sum is good to
constexpr int kMaxBacktracks = 40;

double largest_component(std::span<const Vec3> g) {
  double largest = 0.0;
  for (const Vec3& part : g) {
    // Written so that NaN counts as infinite.
    if (!(part.cwiseAbs().maxCoeff() <= largest)) largest = part.cwiseAbs().maxCoeff();
  }
  return largest;
}

double dot(std::span<const Vec3> a, std::span<const Vec3> b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i].dot(b[i]);
  return sum;
}

}  // namespace

bool NewtonMinimiser::factor(std::span<const double> values) {
  return cholesky_->factor(values).factorized;
}

MinimiserReport NewtonMinimiser::minimise(IncrementalPotential& energy, std::span<Vec3> x,
                                          double tolerance) {
  const std::size_t n = x.size();
  const BlockPattern& pattern = energy.pattern();
  if (!cholesky_) {
    const auto size = static_cast<std::int32_t>(3 * n);
    cholesky_.emplace(SparsePattern{size, size, pattern.columns, pattern.rows},
                      CholeskyOptions{.block = 3});
  }
  MinimiserReport report;
  std::vector<Vec3> g(n), dx(n), trial(n);
  std::vector<double> values(pattern.rows.size());
  for (;; ++report.iterations) {
    poll_interrupt();
    energy.assemble(x, 0.0, g, values);
    report.residuals.push_back(largest_component(g));
    report.converged = report.residuals.back() <= tolerance;
    if (report.converged || report.iterations == max_iterations_ ||
        !std::isfinite(report.residuals.back())) {
      return report;
    }
    ++report.factorizations;
    if (!factor(values)) return report;
    for (std::size_t i = 0; i < n; ++i) dx[i] = -g[i];
    const std::span<double> flat(dx[0].data(), 3 * n);
    cholesky_->solve(flat, flat);

    const double start = energy.energy(x), slope = dot(g, dx);
    double s = energy.step_bound(x, dx);
    for (int tried = 0;; ++tried, s /= 2) {
      for (std::size_t i = 0; i < n; ++i) trial[i] = x[i] + s * dx[i];
      if (energy.energy(trial) <= start + kArmijo * s * slope + kRounding * std::abs(start)) break;
      if (tried == kMaxBacktracks) return report;
      ++report.backtracks;
    }
    std::copy(trial.begin(), trial.end(), x.begin());
  }
}

}  // namespace substep::springs
