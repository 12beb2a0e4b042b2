// XSPH: velocities relax towards those around them.
#pragma once

#include "substep/pbf/neighbourhood.h"

namespace substep::pbf {

// Schechter and Bridson (2012), "Ghost SPH for animating water", section 4.3 (Macklin and Mueller
// 2013, eq. 17):
//   v_i' = v_i + c sum_j V 2 m_j / (m_i + m_j) W_ij (v_j - v_i).
// The factor 2 m_j / (m_i + m_j) is 1 for equal masses; with it the exchange is symmetric, and
// linear momentum is conserved, for unequal ones too. The forces are not along x_i - x_j: angular
// momentum is not conserved. The viscosity it amounts to depends on spacing and step; `Viscosity`
// is the physical one. c from 0 to 1; v_new: n + 1 rows, not those of near.v, whose w they get.
template <class Real>
void xsph(const Neighbourhood<Real>& near, Real c, std::span<Point<Real>> v_new);

}  // namespace substep::pbf
