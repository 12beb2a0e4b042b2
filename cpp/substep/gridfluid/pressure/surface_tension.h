// Surface tension: the pressure at the surface of a liquid of particles is the tension times the
// sum of the principal curvatures there, above 0 for a drop. Where the surface crosses the way
// between the middles of two cells, that stands as the pressure in the ghost fluid method (Kang,
// Fedkiw and Liu, "A boundary condition capturing method for multiphase incompressible flow",
// 2000).
//
// A level set from particles is bumpy at the size of a cell. So the liquid's part of each cell,
// 1/2 - phi cut to [0, 1], is smoothed by G, sweeps of (1, 2, 1) / 4 along each axis, to c = (2 G -
// G G)(1/2 - phi): a Gaussian would take more from the curvature of a wave. The curvature is that
// of the level c = 1/2. Of the levels that pass through other cells it lessens outwards, which
// would pull bumps out as heavy liquid above light does (Rayleigh, Taylor). So it is continued
// along the normal n by d(kappa) / dn = -|grad n|^2, and a little is added with the distance of a
// cell from where the surface should be: that draws in the bumps that smoothing has taken from
// kappa, and is nothing on a smooth surface.
#pragma once

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/pressure/obstacles.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

template <class Real, int D>
class SurfaceTension {
 public:
  // What the pressure at the surface does to velocities: with it, that of the projection, whose
  // domain is set, is 0 there. q_of_curvature is sigma dt / (density cell^2) [m/s]; phi [cells] is
  // that of level_set(), with ghosts: mirrored at closed sides, where the surface so stands at a
  // right angle.
  void pull(const Layout<D>& layout, const Obstacles<Real, D>& obstacles,
            const Projection<Real, D>& projection, const Real* phi, double q_of_curvature,
            const Velocity<Real, D>& u, int threads);

 private:
  // kappa_ [1/cell] in cells that have the surface between themselves and one next to them.
  void find_curvature(const Layout<D>& layout, const Real* phi, int threads);

  AlignedBuffer<Real> kappa_, once_, twice_;
};

extern template class SurfaceTension<float, 2>;
extern template class SurfaceTension<float, 3>;
extern template class SurfaceTension<double, 2>;
extern template class SurfaceTension<double, 3>;

}  // namespace substep::gridfluid
