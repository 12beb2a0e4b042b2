// Fixed-corotated elasticity: psi = mu |F - R|^2 + lambda/2 (J - 1)^2 = mu sum (sigma_i - 1)^2 +
// lambda/2 (J - 1)^2, so tau = 2 mu (F - R) F^T + lambda (J - 1) J I, whose principal values are
// 2 mu (sigma_i - 1) sigma_i + lambda (J - 1) J. Stomakhin, Howes, Schroeder, Teran, "Energetically
// consistent invertible elasticity", 2012.
//
// No singular value decomposition: the axes of tau are those of b = F F^T, |sigma_i| the roots of
// its eigenvalues. Where det F < 0 the smallest takes the sign, as in Irving, Teran, Fedkiw,
// "Invertible finite elements", 2004, so that inverted material returns through the flat state.
#pragma once

#include "substep/mpm/materials/material.h"
#include "substep/mpm/materials/principal.h"

namespace substep::mpm {

// sigma_i and their inverses, of the eigenvalues d of b and J = det F. Eigenvalues below 1e-30,
// which rounding can make of 0, count as 1e-30.
template <class V>
SUBSTEP_INLINE void signed_stretches(const V (&d)[3], const V& J, V (&sigma)[3], V (&inverse)[3]) {
  for (int i = 0; i < 3; ++i) {
    const V square = d[i] < Lane<V>(1e-30) ? splat<V>(Lane<V>(1e-30)) : d[i];
    inverse[i] = inverse_root<V>(square);
    sigma[i] = square * inverse[i];
  }
  const auto inverted = J < 0;
  if (any(inverted)) {
    const auto first = inverted & (d[0] <= d[1]) & (d[0] <= d[2]);
    const auto second = inverted & ~first & (d[1] <= d[2]);
    const decltype(first) flips[3] = {first, second, inverted & ~first & ~second};
    for (int i = 0; i < 3; ++i) {
      sigma[i] = flips[i] ? -sigma[i] : sigma[i];
      inverse[i] = flips[i] ? -inverse[i] : inverse[i];
    }
  }
}

template <class V>
SUBSTEP_INLINE void corotated_stress(const V (&sigma)[3], const V& J, const V& mu, const V& lambda,
                                     V (&t)[3]) {
  const V pressure = lambda * (J - 1) * J, twice = mu + mu;
  for (int i = 0; i < 3; ++i) t[i] = fma<V>(twice * sigma[i], sigma[i] - 1, pressure);
}

template <class V, int D>
SUBSTEP_INLINE V corotated_energy(const Tensor<V, D>& F, Lane<V> mu, Lane<V> lambda) {
  const SymmetricTensor<V, D> b[1] = {left_cauchy_green(F)};
  Principal<V, D> axes[1];
  principal_axes(b, axes);
  V sigma[3], inverse[3], sum{};
  const V J = determinant(F);
  signed_stretches(axes[0].d, J, sigma, inverse);
  for (const V& s : sigma) sum += (s - 1) * (s - 1);
  return mu * sum + lambda / 2 * ((J - 1) * (J - 1));
}

// d tau_i / d ln sigma_j = 2 mu (2 sigma_i^2 - sigma_i) delta_ij + lambda (2 J^2 - J).
template <class V, int D>
SUBSTEP_INLINE V corotated_modulus(const Tensor<V, D>& F, Lane<V> mu, Lane<V> lambda) {
  const V square = largest_row(left_cauchy_green(F)), J = determinant(F);
  return 2 * mu * larger<V>(2 * square - sqrt<V>(square), V{}) +
         lambda * larger<V>(2 * J * J - J, V{});
}

struct FixedCorotated {
  static constexpr const char* kName = "fixed_corotated";
  static constexpr int kTogether = kSideBySide;
  static constexpr bool kHasF = true;
  static constexpr bool kInverts = true;
  static constexpr std::array<StateField, 0> kState{};
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;  // [kg/m^3], Lame's parameters [Pa]

  template <class Constants>
  static FixedCorotated with(const Constants& c) {
    return {.density = c("density"), .mu = c("mu"), .lambda = c("lambda")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    SymmetricTensor<V, D> b[kPackets];
    Principal<V, D> axes[kPackets];
    for (int k = 0; k < kPackets; ++k) b[k] = left_cauchy_green(Tensor<V, D>::load(fields[k]));
    principal_axes(b, axes);
    for (int k = 0; k < kPackets; ++k) {
      const V J = determinant(Tensor<V, D>::load(fields[k]));
      V sigma[3], inverse[3], t[3];
      signed_stretches(axes[k].d, J, sigma, inverse);
      corotated_stress<V>(sigma, J, splat<V>(Lane<V>(mu)), splat<V>(Lane<V>(lambda)), t);
      tau[k] = in_axes(axes[k], t);
    }
  }

  template <class V, int D>
  SUBSTEP_INLINE V energy_density(const V* fields) const {
    return corotated_energy(Tensor<V, D>::load(fields), Lane<V>(mu), Lane<V>(lambda));
  }

  template <class V, int D>
  SUBSTEP_INLINE V wave_modulus(const V* fields) const {
    return corotated_modulus(Tensor<V, D>::load(fields), Lane<V>(mu), Lane<V>(lambda));
  }

  double kinematic_viscosity() const { return 0; }
  bool hyperelastic() const { return true; }
};

}  // namespace substep::mpm
