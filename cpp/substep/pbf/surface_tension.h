// Surface tension in N/m, by forces between pairs of particles.
#pragma once

#include <vector>

#include "substep/pbf/neighbourhood.h"

namespace substep::pbf {

// Akinci, Akinci and Teschner (2013), "Versatile surface tension and adhesion for SPH fluids", with
// volumes in the place of masses, u = x_ij / |x_ij| and q = |x_ij| / h:
//   cohesion (eq. 1, 2)         F_ij = -s V^2 K_ij c(q) u,
//     c = (1 - q)^3 q^3 for 2 q > 1, 2 (1 - q)^3 q^3 - 1/64 below (it repels when close);
//   area minimisation (eq. 3)   F_ij = -a V^2 K_ij (1 - q)^2 ((n_i - n_j) . u) u,
//     n_i = h sum_j V grad W_ij (eq. 4);
//   K_ij = 2 / (D_i + D_j), D_i = sum_j V W_ij with i itself (eq. 5, without walls).
// Deviation: in eq. 3 the whole of n_i - n_j acts, and alike up to |x_ij| = h. Here its part along
// u, fading towards h: so angular momentum is conserved, and nothing jumps where neighbours come
// and go.
//
// s and a follow from the tension sigma [N/m]. The tension of a flat surface is what the stress
// along it lacks against that across it (Kirkwood and Buff 1949): with f_ij the pull of a pair,
//   sigma = 1/A sum_pairs f_ij (x^2 - z^2) / r,
// x along, z across. Where nothing but the half space z < 0 is filled, evenly, that is
//   sigma = C_s s h^(d + 2) + C_a a h^(d + 2)
// with the numbers below (by quadrature; without K the first is (pi / 8) (21 / 28160) in 3D, the
// formula of Fowler 1937). Each is given half of the tension: with less to the second, cohesion
// alone keeps the particles boiling. Particles do not fill space evenly: bars and strips contract
// with structure() times that tension (measured, docs/pbf_forces.md), which is divided out.
template <class Real>
class SurfaceTension {
 public:
  static constexpr double kAreaShare = 0.5;
  static constexpr double structure(int dimension) { return dimension == 2 ? 1.40 : 1.55; }
  static constexpr double cohesion_tension(int dimension) {
    return dimension == 2 ? 4.653e-4 : 3.599e-4;
  }
  static constexpr double area_tension(int dimension) {
    return dimension == 2 ? 1.2705e-2 : 7.740e-3;
  }

  // x_i += factor F_i / m_i: dt^2 for positions, dt for velocities; x: n + 1 rows, not those of
  // near.x. reference_mass: m_0 [kg].
  // To be called with positions that the density solver is about to correct, so that both sides of
  // the balance of cohesion and pressure belong to the same positions: with forces of a step ago
  // their torques do not cancel, and a rotating drop spins up.
  void displace(const Neighbourhood<Real>& near, double sigma, double reference_mass, Real factor,
                std::span<Point<Real>> x);

 private:
  std::vector<Point<Real>> normals_;  // n, w: D
};

extern template class SurfaceTension<float>;
extern template class SurfaceTension<double>;

}  // namespace substep::pbf
