// Elastic tetrahedra of Young's modulus and Poisson's ratio: the stable neo-Hookean energy of
// Smith, de Goes, Kim, "Stable neo-Hookean flesh simulation", ACM TOG 37(2), 2018, eq. 14, per rest
// volume,
//
//   Psi = m/2 (I - log(I + 1)) + l/2 (J - a)^2 + constant,   I = |F|^2,  J = det F
//   m = 4/3 mu,  l = lambda + 5/6 mu,  a = 1 + 3/4 m / l     (springs/elastic_energy.h)
//
// as two constraints, whose XPBD energies C^2 / (2 alpha) add up to V_0 Psi: the way of Macklin and
// Mueller, "A constraint-based formulation of stable neo-Hookean materials", MIG 2021, section 4,
// who take the energy without the logarithm, to which a tetrahedron that collapsed is at rest. With
// F = D_s D_m^-1, D_s = (x_1 - x_0, x_2 - x_0, x_3 - x_0), and D_m the same at rest:
//
//   deviatoric    C = sqrt(I - log(I + 1)),  alpha = 1 / (m V_0),  dC/dF = I / ((I + 1) C) F
//   hydrostatic   C = J - a,                 alpha = 1 / (l V_0),  dC/dF = cof F
//
// and dC/d(x_1, x_2, x_3) = dC/dF D_m^-T, dC/dx_0 minus the sum of these. Both are finite for every
// shape; the hydrostatic one turns an inverted tetrahedron back. Its J is V / V_0, so that it needs
// no D_m. At rest the two hold each other in balance with multipliers that are not 0, which few
// iterations miss. The deviatoric gradient is 0 for coincident points only, where C is 0 too; the
// hydrostatic one for points on a line.
#pragma once

#include <array>

#include "substep/core/log.h"
#include "substep/pbd/constraints/lanes3.h"
#include "substep/pbd/constraints/tetrahedron_volume.h"

namespace substep::pbd {

// a - log(a + 1) for a >= 0: a^2 (1/2 - a/3 + a^2/4 - ...) where the difference would lose digits.
template <class V>
SUBSTEP_INLINE V minus_log_one_plus(const V& a) {
  using T = Lane<V>;
  constexpr int kTerms = sizeof(T) == 8 ? 15 : 7;
  V series{};
#pragma GCC unroll 16
  for (int k = kTerms; k >= 0; --k) {
    series = fma<V>(-a, series, splat<V>(T(1) / T(k + 2)));
  }
  return a < T(0.1) ? a * a * series : a - log<V>(a + T(1));
}

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
    const V square = dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2]);
    c = square_root(minus_log_one_plus<V>(square));
    const V scale = quotient<V>(square, (square + Lane<V>(1)) * c, V{});
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
  static constexpr int kParameters = 2;  // 1 / V_0, a
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
