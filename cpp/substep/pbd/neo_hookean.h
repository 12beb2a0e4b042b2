// Elastic tetrahedra of Young's modulus and Poisson's ratio: the stable neo-Hookean energy
//
//   Psi = mu/2 (|F|^2 - 3) + lambda/2 (det F - gamma)^2,   gamma = 1 + mu / lambda
//
// of Smith, de Goes, Kim, "Stable neo-Hookean flesh simulation", 2018, eq. 13, as two constraints:
// Macklin and Mueller, "A constraint-based formulation of stable neo-Hookean materials", MIG 2021,
// eq. 9-18. In a tetrahedron of rest volume V_0 with F = D_s D_m^-1, D_s = (b - a, c - a, d - a):
//
//   deviatoric    C = |F| - 0,       alpha = 1 / (mu V_0),      dC/dF = F / |F|
//   hydrostatic   C = det F - gamma, alpha = 1 / (lambda V_0),  dC/dF = cof F
//
// and dC/d(b, c, d) = dC/dF D_m^-T, dC/da = -sum of these. Both are finite for every shape, and the
// hydrostatic one turns an inverted tetrahedron back. Its det F is V / V_0, so that it needs no
// D_m. At rest the two hold each other in balance with multipliers that are not 0: the material is
// at rest once they are found, in one substep as the iterations converge. The gradient of the
// deviatoric one is 0 for coincident points only, that of the hydrostatic one for points on a line.
//
// mu, lambda are the coefficients of this energy, with which F = 1 has no stress; Poisson's ratio
// and Young's modulus of small strains are those of mu and lambda - mu (python/substep/pbd.py).
#pragma once

#include <array>

#include "substep/pbd/lanes3.h"
#include "substep/pbd/tetrahedron_volume.h"

namespace substep::pbd {

struct NeoHookeanDeviatoric {
  static constexpr const char* kName = "neo_hookean_deviatoric";
  static constexpr int kPoints = 4;
  static constexpr int kParameters = 9;  // D_m^-1 row by row
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 4>& x, const std::array<V, 9>& p,
                                      V& c, std::array<Lanes3<V>, 4>& gradient) {
    const Lanes3<V> u = x[1] - x[0], v = x[2] - x[0], w = x[3] - x[0];
    std::array<Lanes3<V>, 3> F;  // columns
#pragma GCC unroll 3
    for (unsigned j = 0; j < 3; ++j) F[j] = p[j] * u + p[3 + j] * v + p[6 + j] * w;
    c = square_root(dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2]));
    const V scale = quotient(V{} + 1, c, V{});
#pragma GCC unroll 3
    for (unsigned j = 0; j < 3; ++j) F[j] = scale * F[j];
#pragma GCC unroll 3
    for (unsigned i = 0; i < 3; ++i) {
      gradient[i + 1] = p[3 * i] * F[0] + p[3 * i + 1] * F[1] + p[3 * i + 2] * F[2];
    }
    gradient[0] = -(gradient[1] + gradient[2] + gradient[3]);
  }
};

struct NeoHookeanHydrostatic {
  static constexpr const char* kName = "neo_hookean_hydrostatic";
  static constexpr int kPoints = 4;
  static constexpr int kParameters = 2;  // 1 / V_0, gamma
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 4>& x, const std::array<V, 2>& p,
                                      V& c, std::array<Lanes3<V>, 4>& gradient) {
    TetrahedronVolume::evaluate<V>(x, {V{}}, c, gradient);
    c = c * p[0] - p[1];
#pragma GCC unroll 4
    for (auto& g : gradient) g = p[0] * g;
  }
};

}  // namespace substep::pbd
