// What the pressure of a liquid gives obstacles over their surface in its cells.
//
// Where q is linear, of the slope g, the integral of q times the normal out of the fluid over the
// surface in a cell is by Gauss's theorem along each axis, with the pressure q of its middle, the
// open parts A of its faces and V of its volume,
//   q (A_below - A_above) + g (V - (A_below + A_above) / 2);
// the second term carries q from the middle to the surface. Each half of the cell has the slope at
// its own face, as the liquid does, and that of the other one where its own is closed. Summed over
// cells with one g that is g times the volume of the fluid, as Archimedes has it, wherever the
// surface lies in the cells. Where both are closed, as in a gap of one cell, it is that of liquid
// at rest, gravity dt [m/s].
//
// To bodies that respond Bodies gives the first term, as the pressure and they are found together.
// The second is given before, with the mean slope of the last pressure around each of them: that is
// gravity dt in liquid at rest, and 0 where all falls. The mean, and not the slopes at the surface,
// as these are what the body itself makes of them: a light one would swing from step to step.
// Facets that respond have the first term alone. The volume by which a body displaces liquid is in
// both terms what the grid sees of it, right within some thousandths: where a body is wholly in the
// liquid, what both lack of its own volume is in the second.
#pragma once

#include <span>

#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

// Sets exchange() of the colliders, but for those that respond, to what they are pushed by in the
// fluid cells of a projection, with q, a pressure times dt / (density dx) [m/s], its slope at rest,
// and the mass of a full cell [kg].
template <class Real, int D>
void push_surface(Obstacles<Real, D>& obstacles, const Projection<Real, D>& projection,
                  std::span<const double> q, const Vec3& rest, double mass, int threads);

// Sets exchange() of those that respond to the second term, with a q of before, and the mass of a
// full cell times what this one is expected to be of it.
template <class Real, int D>
void push_before(Obstacles<Real, D>& obstacles, std::span<const Cell> cells,
                 std::span<const double> q, double mass, int threads);

}  // namespace substep::gridfluid
