// The surface of a liquid of particles, as a signed distance at the centres of cells.
//
// Where the particles fill a half-space, their number density (density.h) is a known function of
// the distance z from its surface, whatever the surface's place in the grid: the trilinear kernel
// lies beyond z with a part (1 - z)^2 / 2 of its weight, and exactly half of it for z = 0 and any
// direction of the surface. So phi = 1 - sqrt(2 rho) outside (rho < 1/2) and sqrt(2 (1 - rho)) - 1
// inside: the surface of a pool at rest is right within 0.05 cells, and smooth, where the union of
// balls around the particles (Zhu, Bridson, "Animating sand as a fluid", 2005) is bumpy or needs a
// radius that fits one place of the surface only. Balls are added for drops and sheets thinner than
// that: phi <= |x - x_p| - r. From the cells at the surface, distances are marched outwards and
// inwards with the upwind scheme of the eikonal equation |grad phi| = 1 (Rouy, Tourin, "A viscosity
// solutions approach to shape-from-shading", 1992), a layer a pass.
#pragma once

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/particles.h"

namespace substep::gridfluid {

template <class Real>
struct SurfaceOptions {
  // Of a particle's ball [cells]. Up to 0.3 those of particles half a cell apart stay within the
  // surface that the density gives.
  Real radius = Real(0.28);
  int layers = 3;  // of cells to march through, beside those at the surface
};

// phi [cells], negative in the liquid; beyond the layers it is layers + 1. `density` is that of
// number_density(), with ghosts; the particles are sorted on the layout. A cell with a particle and
// with all cells next to it in the liquid is in it too. Ghosts are set.
template <class Real, int D>
void level_set(const Particles<Real, D>& particles, const Layout<D>& layout, const Real* density,
               const SurfaceOptions<Real>& options, Real* phi, AlignedBuffer<Real>& scratch,
               int threads);

}  // namespace substep::gridfluid
