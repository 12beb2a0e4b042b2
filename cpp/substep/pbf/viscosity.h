// Viscosity in m^2/s, implicit.
#pragma once

#include <vector>

#include "substep/pbf/neighbourhood.h"
#include "substep/pbf/options.h"

namespace substep::pbf {

// Implicit viscosity after Weiler, Koschier, Brand and Bender (2018), "A physically consistent
// implicit viscosity solver for SPH fluids", eq. 7-9: with d dimensions and u = x_ij / |x_ij|,
//   F_i = -sum_j 2 (d + 2) mu_ij V^2 G_ij (v_ij . u) u,
//   m_i (v_i' - v_i) = dt F_i(v').
// Deviations:
// - There, G = -W' / r. But these forces are central, and with the 30 neighbours of a support of
// two
//   spacings -W' leaves most to the six nearest, which do not resist shear along the axes of their
//   lattice: 0.66 of nu there, 1.2 in other directions. Here G ~ (1 - q) + (1 - q)^2, q = r / h,
//   with which the lattice's tensor sum_j G r^2 u u u u is isotropic within a few percent, scaled
//   to sum_j V G r^2 = d in the lattice.
// - V is the volume at rest (see Neighbourhood).
// - mu_ij = 2 mu_i mu_j / (mu_i + mu_j), mu = nu rho_0: one stress on both sides where fluids meet.
// - The conjugate gradients are preconditioned by the masses alone, not by 3 x 3 blocks. So every
//   direction M^-1 F has, pair by pair, no linear and no angular momentum, and both are conserved
//   whatever the tolerance.
// The matrix is never stored: I + dt M^-1 L is symmetric positive definite in the product <a, b> =
// sum m a . b with any nu; its condition is about 1 + 20 nu dt / spacing^2. Where the sum reaches
// beyond the surface nothing pulls: a free surface, and a wall, has no traction from this term.
template <class Real>
class Viscosity {
 public:
  static constexpr Real kNone = Real(1e-20);  // what stands for nu = 0 [m^2/s]

  // nu: kinematic viscosity of each particle [m^2/s] in cell order, or one for all; v: n + 1 rows,
  // not those of near.v, whose w they get. Stops where the residual is below `tolerance`.
  ViscosityReport solve(const Neighbourhood<Real>& near, std::span<const Real> nu, Real dt,
                        Real tolerance, int max_iterations, std::span<Point<Real>> v);

 private:
  // Scale of G, times V h^2.
  static double weight_scale(const Neighbourhood<Real>& near);
  // f = M^-1 A p, A = M + dt L; returns <p, f>.
  double multiply(const Neighbourhood<Real>& near, Real dt);

  std::vector<Point<Real>> p_;  // search direction, w: nu m / m_0
  std::vector<Point<Real>> f_;  // M^-1 A p
  std::vector<Point<Real>> r_;  // M^-1 (b - A v), b = M v_old
};

extern template class Viscosity<float>;
extern template class Viscosity<double>;

}  // namespace substep::pbf
