// What the pressure of a liquid gives obstacles over their surface in its cells.
//
// Where q is linear, of the slope g, the integral of q times the normal out of the fluid over the
// surface in a cell is by Gauss's theorem along each axis, with the pressure q of its middle, the
// open parts A of its faces and V of its volume,
//   q (A_below - A_above) + g (V - (A_below + A_above) / 2);
// the second term carries q from the middle to the surface. Each half of the cell has the slope at
// its own face, as the liquid does, and that of the other one where its own is closed. Summed over
// cells with one g that is g times the volume of the fluid, as Archimedes has it, wherever the
// surface lies in the cells.
#pragma once

#include <span>

#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

// Sets exchange() of the colliders, but for those that yield, to what they are pushed by in the
// fluid cells of a projection, with q, a pressure times dt / (density dx) [m/s], and the mass of a
// full cell [kg].
template <class Real, int D>
void push_surface(Obstacles<Real, D>& obstacles, const Projection<Real, D>& projection,
                  std::span<const double> q, double mass, int threads);

}  // namespace substep::gridfluid
