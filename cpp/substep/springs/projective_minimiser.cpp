#include "substep/springs/projective_minimiser.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"

namespace substep::springs {

// M / h^2 + L with rows of the identity for pins.
void ProjectiveMinimiser::factorize(const IncrementalPotential& energy) {
  const auto n = static_cast<std::int32_t>(energy.vertices());
  const BlockPattern& blocks = energy.pattern();
  if (!cholesky_) {
    lower_ = {n, n, {0}, {}};
    for (std::int32_t i = 0; i < n; ++i) {
      lower_.row.push_back(i);
      lower_.row.insert(lower_.row.end(), blocks.neighbours.begin() + blocks.starts[i],
                        blocks.neighbours.begin() + blocks.starts[i + 1]);
      lower_.start.push_back(static_cast<std::int32_t>(lower_.row.size()));
    }
    cholesky_ = std::make_unique<SupernodalCholesky<>>(lower_, 1);
  }
  const double h = energy.step();
  const auto pinned = energy.pinned();
  std::vector<double> values(lower_.row.size(), 0.0);
  for (std::int32_t i = 0; i < n; ++i) {
    values[lower_.start[i]] = energy.masses()[i] / (h * h);
  }
  for (const auto& term : energy.terms()) {
    const auto ids = term->vertices();
    const auto refuse = [] {
      throw InputError("solver: 'projective' is for springs without contact; use 'newton'");
    };
    if (term->roves()) refuse();
    for (std::int64_t e = 0; e < element_count(*term); ++e) {
      double weight = term->curvature_bound(e);
      if (!std::isfinite(weight)) refuse();
      if (term->dissipative()) weight /= h;
      const std::int32_t* v = ids.data() + e * term->arity();
      for (int a = 0; a < term->arity(); ++a) {
        if (!pinned[v[a]]) values[lower_.start[v[a]]] += weight;
      }
      if (term->difference() && !pinned[v[0]] && !pinned[v[1]]) {
        values[lower_.find(std::max(v[0], v[1]), std::min(v[0], v[1]))] -= weight;
      }
    }
  }
  h_ = 0.0;
  if (cholesky_->factorize(values, energy.threads()) >= 0) {
    throw SingularMatrixError("the matrix of projective dynamics is not positive definite");
  }
  h_ = h;
  pinned_.assign(pinned.begin(), pinned.end());
}

MinimiserReport ProjectiveMinimiser::minimise(IncrementalPotential& energy, std::span<Vec3> x,
                                              double /*tolerance*/) {
  const std::size_t n = x.size();
  MinimiserReport report;
  if (h_ != energy.step() || !std::ranges::equal(pinned_, energy.pinned())) {
    factorize(energy);
    ++report.factorizations;
  }
  g_.resize(n);
  std::copy(energy.target().begin(), energy.target().end(), x.begin());
  for (; report.iterations < iterations_; ++report.iterations) {
    poll_interrupt();
    energy.gradient(x, g_);
    if (n > 0) cholesky_->solve(std::span(g_[0].data(), 3 * n), energy.threads());
    for (std::size_t i = 0; i < n; ++i) x[i] -= g_[i];
  }
  energy.gradient(x, g_);
  report.residuals.push_back(largest_component(g_));
  report.converged = std::isfinite(report.residuals.back());
  return report;
}

}  // namespace substep::springs
