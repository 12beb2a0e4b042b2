// Bending of a surface that hardly stretches, quadratic in the positions.
//
// Points as in dihedral_bending.h: the edge (a, b), then the corners c and d. Bergou, Wardetzky,
// Harmon, Zorin, Grinspun, "A quadratic bending model for inextensible surfaces", SGP 2006, eq.
// 2-4: the energy k/2 x^T Q x of a hinge has Q = 3 / (A_1 + A_2) K^T K, where K holds sums of
// cotangents of the rest shape. With L = sum_i k_i x_i, k_i = K_i / sqrt(A_1 + A_2), which is |e|
// theta / sqrt(A_1 + A_2) along the normal for small angles:
//
//   C = |L| - L_0,   dC/dx_i = k_i L / |L|
//
// so that the XPBD energy C^2 / (2 alpha) is a third of Bergou's; L_0 is |L| at rest, 0 when flat.
// On equilateral triangles 1 / alpha is then the rigidity D [J] of a bend into a cylinder, D/2
// kappa^2 per area in every direction (Seung, Nelson, Phys. Rev. A 38, 1988, 1005: a plate of
// Poisson's ratio -1/3); with the factor 3, spheres are exact instead. (Bender et al., "A survey
// on position based dynamics", 2017, section 5, take C = 1/2 x^T Q x itself: an energy of the
// fourth power of the angle.) Flat points have L = 0: no direction, gradient 0.
#pragma once

#include <array>

#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct IsometricBending {
  static constexpr const char* kName = "isometric_bending";
  static constexpr int kPoints = 4;
  static constexpr int kParameters = 4;  // k_b, k_c, k_d, L_0; k_a is minus the sum of these
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 4>& x, const std::array<V, 4>& p,
                                      V& c, std::array<Lanes3<V>, 4>& gradient) {
    const Lanes3<V> L = p[0] * (x[1] - x[0]) + p[1] * (x[2] - x[0]) + p[2] * (x[3] - x[0]);
    const V length = square_root(dot(L, L));
    c = length - p[3];
    const Lanes3<V> direction = quotient(V{} + 1, length, V{}) * L;
    gradient[1] = p[0] * direction;
    gradient[2] = p[1] * direction;
    gradient[3] = p[2] * direction;
    gradient[0] = -(p[0] + p[1] + p[2]) * direction;
  }
};

}  // namespace substep::pbd
