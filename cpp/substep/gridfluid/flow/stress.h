// What a flow gives to obstacles: its pressure and its shear at their surfaces.
//
// In each cell that a surface cuts, the pressure is carried on to it along its normal from two
// places in the flow, and the shear is mu times the slope there of the velocities beside those of
// the obstacle, by the parabola through the surface and two places.
#pragma once

#include <span>

#include "substep/gridfluid/flow/extension.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

template <class Real, int D>
struct Stress {
  // Sets exchange() of the obstacles' colliders. u: with ghosts; q: pressure times dt / (density
  // cell) [m/s]; density: of cells, in parts of that one, or empty where it is the same; mass: of a
  // full cell [kg]; shear: kinematic viscosity times dt over a cell [m].
  static void push(const Layout<D>& layout, Obstacles<Real, D>& obstacles,
                   std::span<const Cell> cells, const Extension<D>& into_cells,
                   const Velocity<Real, D>& u, std::span<double> q, std::span<const Real> density,
                   double mass, double shear, int threads);
};

extern template struct Stress<float, 2>;
extern template struct Stress<float, 3>;
extern template struct Stress<double, 2>;
extern template struct Stress<double, 3>;

}  // namespace substep::gridfluid
