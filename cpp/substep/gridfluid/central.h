// Advection by fluxes through the faces of cells: of second order, for steps of less than a cell.
//
// Velocities by Harlow and Welch's central differences, "Numerical calculation of time-dependent
// viscous incompressible flow of fluid with free surface", 1965: without divergence they keep
// momentum and, but for the error of time, energy. They are written in the advective form,
//   -sum_b (v_b+ (u_b+ - u) + v_b- (u - u_b-)) / (2 dx),
// with v the flow through the faces of the cell around u, of which obstacles leave a part, and
// u_b+, u_b- its neighbours: as v has no divergence, neither momentum nor energy comes from it.
// Scalars by the limited scheme of third order of Koren, "A robust upwind discretization method for
// advection, diffusion and source terms", 1993, which makes no new extremes.
#pragma once

#include <array>
#include <span>

#include "substep/gridfluid/flow_sides.h"

namespace substep::gridfluid {

template <class Real, int D>
struct Fluxes {
  // -(v grad) u_a [m/s per (m/s) a cell] at faces of axis a that the flow changes. In open sides it
  // is carried upwind, and what flows in comes from rest.
  static void central(const Layout<D>& layout, const SideGhosts<Real, D>& sides,
                      const Velocity<Real, D>& v, const Velocity<Real, D>& u, std::size_t a,
                      std::span<Real> out, int threads);
  // -(u grad) x of a scalar at cells, by the flux through the open parts of faces. open: nothing
  // where all are.
  static void limited(const Layout<D>& layout, const Velocity<Real, D>& u,
                      const std::array<std::span<const Real>, D>& open, std::span<const Real> x,
                      std::span<Real> out, int threads);
};

extern template struct Fluxes<float, 2>;
extern template struct Fluxes<float, 3>;
extern template struct Fluxes<double, 2>;
extern template struct Fluxes<double, 3>;

}  // namespace substep::gridfluid
