// Vorticity confinement: Fedkiw, Stam and Jensen, "Visual simulation of smoke", 2001, eq. 9 to 11:
//   f = epsilon (N x omega),  N = grad |omega| / |grad |omega||,
// which gives eddies back what coarse grids take from them. Theirs is epsilon over the cell.
#pragma once

#include <span>

#include "substep/gridfluid/flow/flow_sides.h"

namespace substep::gridfluid {

template <class Real, int D>
struct Confinement {
  // Adds f dt to changes of the velocities u, with ghosts. strength: epsilon dt over a cell; omega
  // and size are arrays to compute in.
  static void add(const Layout<D>& layout, const SideGhosts<Real, D>& sides,
                  const Velocity<Real, D>& u, double strength, Velocity<Real, D> changes,
                  Velocity<Real, D> omega, std::span<Real> size, int threads);
};

extern template struct Confinement<float, 2>;
extern template struct Confinement<float, 3>;
extern template struct Confinement<double, 2>;
extern template struct Confinement<double, 3>;

}  // namespace substep::gridfluid
