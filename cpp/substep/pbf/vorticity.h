// Vorticity, and the confinement that gives small eddies back what the method damps.
#pragma once

#include <vector>

#include "substep/pbf/neighbourhood.h"

namespace substep::pbf {

// Macklin and Mueller (2013), "Position based fluids", eq. 15, with the volume that it leaves out:
//   omega_i = sum_j V grad W_ij x (v_j - v_i)   [1/s]
// into rows x, y, z; w is |omega_i|. omega: n + 1 rows.
template <class Real>
void vorticity(const Neighbourhood<Real>& near, std::span<Point<Real>> omega);

// Eq. 16: the acceleration f_i = epsilon N x omega_i along N = eta / |eta|, eta = grad |omega|.
// Deviations: eta_i = sum_j V (|omega_j| - |omega_i|) grad W_ij, which is 0 where |omega| is
// uniform, also at a surface; and the sum of the forces, which eq. 16 leaves to chance, is taken
// off again, from each particle in proportion to |m_i f_i|. So linear momentum is conserved, and
// a particle without vorticity is not moved. Angular momentum and energy are not conserved: to
// add them is what confinement is for.
template <class Real>
class VorticityConfinement {
 public:
  // v_i += dt f_i; epsilon [m/s]. v may be near.v.
  void apply(const Neighbourhood<Real>& near, Real epsilon, Real dt, std::span<Point<Real>> v);

 private:
  std::vector<Point<Real>> omega_;
  std::vector<Point<Real>> impulse_;  // dt f m / m_0 [m/s], w: its length
};

extern template class VorticityConfinement<float>;
extern template class VorticityConfinement<double>;

}  // namespace substep::pbf
