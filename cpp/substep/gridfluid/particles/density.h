// How densely the particles lie: what the density projection of Kugelstadt, Longva, Thuerey,
// Bender, "Implicit density projection for volume conserving liquids", 2019, makes even. Its
// displacements are applied by displace() of move.h.
#pragma once

#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/particles.h"

namespace substep::gridfluid {

// sum w / rest over the particles around the centre of each cell, w trilinear: 1 inside of a
// lattice of `rest` particles a cell, and next to closed sides too, which mirror it. Ghosts are
// set.
template <class Real, int D>
void number_density(const Particles<Real, D>& particles, const Layout<D>& layout, Real rest,
                    Real* density, int threads);

}  // namespace substep::gridfluid
