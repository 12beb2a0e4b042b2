// Neo-Hookean elasticity, compressible: psi = mu/2 (tr b - 3) - mu ln J + lambda/4 (J^2 - 1 - 2 ln
// J), so tau = P F^T = mu (b - I) + lambda/2 (J^2 - 1) I with b = F F^T, J = det F. Simo and
// Hughes, "Computational Inelasticity", 1998, eq. 9.2.3 (with its U(J)). det F <= 0: no answer.
#pragma once

#include "substep/core/log.h"
#include "substep/mpm/materials/material.h"

namespace substep::mpm {

struct NeoHookean {
  static constexpr const char* kName = "neo_hookean";
  static constexpr bool kHasF = true;
  static constexpr bool kInverts = false;
  static constexpr std::array<StateField, 0> kState{};
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;  // [kg/m^3], Lame's parameters [Pa]

  template <class Constants>
  static NeoHookean with(const Constants& c) {
    return {.density = c("density"), .mu = c("mu"), .lambda = c("lambda")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    const Lane<V> half_lambda = static_cast<Lane<V>>(lambda / 2), m = static_cast<Lane<V>>(mu);
    for (int k = 0; k < kPackets; ++k) {
      const auto F = Tensor<V, D>::load(fields[k]);
      const V J = determinant(F);
      const V spherical = fma(half_lambda, J * J, splat<V>(-half_lambda - m));
      const auto b = left_cauchy_green(F);
      for (int i = 0; i < b.kEntries; ++i) tau[k].m[i] = m * b.m[i];
      const V pressure = spherical + nan_unless<V>(J > 0);
      for (int i = 0; i < 3; ++i) tau[k].m[i] += pressure;
    }
  }

  template <class V, int D>
  SUBSTEP_INLINE V energy_density(const V* fields) const {
    const auto F = Tensor<V, D>::load(fields);
    const V J = determinant(F), log_J = log<V>(J) + nan_unless<V>(J > 0);
    return Lane<V>(mu / 2) * (left_cauchy_green(F).trace() - 3) - Lane<V>(mu) * log_J +
           Lane<V>(lambda / 4) * (J * J - 1 - 2 * log_J);
  }

  // d tau_i / d ln lambda_j = 2 mu b_i delta_ij + lambda J^2.
  template <class V, int D>
  SUBSTEP_INLINE V wave_modulus(const V* fields) const {
    const auto F = Tensor<V, D>::load(fields);
    const V J = determinant(F);
    return Lane<V>(2 * mu) * largest_row(left_cauchy_green(F)) + Lane<V>(lambda) * J * J;
  }

  double kinematic_viscosity() const { return 0; }
  bool hyperelastic() const { return true; }
};

}  // namespace substep::mpm
