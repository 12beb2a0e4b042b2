// Two fluids in one flow: their densities, and what gravity does to them.
#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/flow/flow.h"
#include "substep/gridfluid/grid/ghosts.h"

namespace substep::gridfluid {

// In parts of the options' density.
template <class Real, int D>
Real Flow<Real, D>::density_of(Real smoke) const {
  const Real ratio = Real(options.smoke_density / options.density);
  return 1 + (ratio - 1) * std::clamp(smoke, Real(0), Real(1));
}

// Of cells, and of faces from here on.
template <class Real, int D>
void Flow<Real, D>::find_density(std::span<const Real> smoke) {
  for_rows(layout_, all_cells(layout_), options.threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      density_[usize(i)] = density_of(smoke[usize(i)]);
    }
  });
  fill_ghosts(layout_, kCentres, density_.data());
  projection_.set_density(obstacles_, span(std::as_const(density_)), options.threads);
}

// What gravity adds in a step beside what the pressure of the fluid of the options' density at rest
// takes back: (1 - rho_0 / rho) g dt. A pressure p with grad p = (rho - rho_0) g balances it, in
// numbers too.
template <class Real, int D>
void Flow<Real, D>::add_weight(std::size_t a, std::int64_t begin, std::int64_t end, Real factor,
                               std::span<Real> x) const {
  const std::int64_t s = layout_.stride[a];
  const Real fall = factor * Real(fall_[static_cast<int>(a)]);
  const Real* const rho = density_.data();
  for (std::int64_t i = begin; i < end && fall != 0; ++i) {
    x[usize(i)] += fall * (1 - 2 / (rho[i - s] + rho[i]));
  }
}

// What viscosity adds to nu div grad u where the density, and so mu = nu rho, varies: of
//   1 / rho div (mu (grad u + grad u^T)),
// with mu in the middle of cells and at edges, what is beyond 1 / rho mu = nu there, as the rest of
// grad u^T has no divergence. At an edge mu is the harmonic mean of its four cells, as two layers
// pass a shear one after the other (Kang, Fedkiw and Liu, "A boundary condition capturing method
// for multiphase incompressible flow", 2000). It is explicit, and bounded where a step is so long
// that it would not be stable.
template <class Real, int D>
void Flow<Real, D>::add_stress(std::span<Real> x, std::size_t a, double k) const {
  const Real bound = Real(0.25 / (D * k) + implicit_part(k) - 0.5), by = Real(k);
  const std::int64_t s = layout_.stride[a];
  const Real *const rho = density_.data(), *const u = start_[a].data();
  for_rows(
      layout_, sides_.inner_faces(a), options.threads, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          const Real over = 2 / (rho[i - s] + rho[i]);
          const auto more = [&](Real there) { return std::min(there * over - 1, bound); };
          Real sum = 2 * (more(rho[i]) * (u[i + s] - u[i]) - more(rho[i - s]) * (u[i] - u[i - s]));
          for (std::size_t b = 0; b < D; ++b) {
            if (b == a) continue;
            const std::int64_t t = layout_.stride[b];
            const Real* const v = start_[b].data();
            const Real own = 1 / rho[i - s] + 1 / rho[i];
            const auto edge = [&](std::int64_t j) {
              return more(4 / (own + 1 / rho[j - s] + 1 / rho[j]));
            };
            sum += edge(i + t) * (u[i + t] - u[i] + v[i + t] - v[i - s + t]) -
                   edge(i - t) * (u[i] - u[i - t] + v[i] - v[i - s]);
          }
          x[usize(i)] += by * sum;
        }
      });
}

// Gravity on the densities that a step comes to, and their matrix.
template <class Real, int D>
void Flow<Real, D>::weigh() {
  find_density(span(next_scalars_[usize(options.smoke)]));
  projection_.set_matrix(options.threads);
  for (std::size_t a = 0; a < D; ++a) {
    for_rows(layout_, sides_.free_faces(a), options.threads,
             [&](std::int64_t begin, std::int64_t end) {
               add_weight(a, begin, end, 1, span(next_[a]));
             });
  }
}

// It is what a step begins with, so that one that has not converged does. Gravity acts for 1 s.
template <class Real, int D>
void Flow<Real, D>::settle() {
  start(0);
  for (std::size_t a = 0; a < D; ++a) copy(velocity_[a], next_[a], options.threads);
  AlignedBuffer<Real>& smoke = next_scalars_[usize(options.smoke)];
  copy(scalars_[usize(options.smoke)], smoke, options.threads);
  fall_ = options.gravity;
  weigh();
  projection_.project(obstacles_, spans(next_), options.tolerance, options.max_iterations,
                      options.threads);
  const std::span<const double> q = projection_.q();
  const std::span<const Cell> cells = projection_.cells();
  const DeferInterrupts deferred;  // from here on nothing fails
  for_numbers(layout_.size, options.threads, [&](std::size_t i) {
    const double p = q[i] * dx_;
    pressure_[i] = cells[i] == Cell::kFluid && std::isfinite(p) ? p : 0.0;
  });
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                     \
  template Real Flow<Real, D>::density_of(Real) const;                                   \
  template void Flow<Real, D>::find_density(std::span<const Real>);                      \
  template void Flow<Real, D>::add_weight(std::size_t, std::int64_t, std::int64_t, Real, \
                                          std::span<Real>) const;                        \
  template void Flow<Real, D>::add_stress(std::span<Real>, std::size_t, double) const;   \
  template void Flow<Real, D>::weigh();                                                  \
  template void Flow<Real, D>::settle();
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::gridfluid
