// Weakly compressible Newtonian fluid. Its shape is forgotten, so J = rho_0 / rho stands for F:
//   J <- det(I + dt G) J,  p = K/gamma (J^-gamma - 1),  tau = -J p I + 2 eta J dev sym G.
// Equation of state: Tait's in the form of Cole, "Underwater explosions", 1948 (gamma = 7 for
// water; Monaghan, "Simulating free surface flows with SPH", 1994); gamma = 1 is p = c^2
// (rho - rho_0), with K = rho_0 c^2. Without tension, p >= 0: J grows where fluid
// separates, but not beyond 1 where the nodes show a density of rho_0: a J that had grown along the
// way of a drop would let it fall into a pool that is full. J <= 0: no answer.
//
// K of water is 2.2e9 Pa; a smaller one, with c about ten times the fastest speed, changes the
// density by about 1 % (Monaghan) and allows longer steps.
#pragma once

#include "substep/core/exp.h"
#include "substep/core/log.h"
#include "substep/mpm/materials/material.h"

namespace substep::mpm {

struct Fluid {
  static constexpr const char* kName = "fluid";
  static constexpr bool kHasF = false;
  static constexpr bool kInverts = false, kAveragesVolume = true, kSeesDensity = true;
  static constexpr std::array<StateField, 1> kState{{{"volume_ratio", "1", 1.0}}};  // J
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, bulk_modulus;  // [kg/m^3], K [Pa]
  double viscosity = 0;          // eta [Pa s]
  double exponent = 7;           // gamma
  bool tension = false;

  template <class Constants>
  static Fluid with(const Constants& c) {
    return {.density = c("density"),
            .bulk_modulus = c("bulk_modulus"),
            .viscosity = c("viscosity"),
            .exponent = c("exponent"),
            .tension = c("tension") != 0};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    Tensor<V, D> A;
    for (int k = 0; k < Tensor<V, D>::kEntries; ++k) A.m[k] = dt * G.m[k];
    for (int i = 0; i < 3; ++i) A.diagonal(i) = A.diagonal(i) + 1;
    fields[0] = determinant(A) * fields[0];
  }

  // What comes together again after a splash has been further apart than it is now.
  template <class V>
  SUBSTEP_INLINE void see(V* fields, const V& density_around) const {
    if (tension) return;
    const V most = larger<V>(splat<V>(1), Lane<V>(density) / density_around);
    fields[0] = smaller<V>(fields[0], most);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&G)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    for (int k = 0; k < kPackets; ++k) {
      const V J = fields[k][0], eta = Lane<V>(viscosity) * J;
      const V spherical = fma(Lane<V>(-2.0 / 3) * eta, trace(G[k]), -J * pressure<V>(J));
      for (int i = 0; i < 3; ++i) tau[k].m[i] = fma(2 * eta, G[k].diagonal(i), spherical);
      for (int i = 0; i < D; ++i) {
        for (int j = i + 1; j < D; ++j) tau[k](i, j) = eta * (G[k](i, j) + G[k](j, i));
      }
    }
  }

  // psi with d psi / dJ = -p: K/gamma (J^(1 - gamma) / (gamma - 1) + J - gamma / (gamma - 1)), or
  // K (J - 1 - ln J).
  template <class V, int D>
  SUBSTEP_INLINE V energy_density(const V* fields) const {
    using T = Lane<V>;
    const V J = compressed<V>(fields[0]), ln = log<V>(J) + nan_unless<V>(J > 0);
    if (exponent == 1) return T(bulk_modulus) * (J - 1 - ln);
    const double g = exponent;
    return T(bulk_modulus / g) * (exp<V>(T(1 - g) * ln) * T(1 / (g - 1)) + (J - T(g / (g - 1))));
  }

  // -d (J p) / d ln J = K J^(1 - gamma) - J p.
  template <class V, int D>
  SUBSTEP_INLINE V wave_modulus(const V* fields) const {
    const V J = compressed<V>(fields[0]), p = pressure<V>(J);
    const V modulus = J * fma(Lane<V>(exponent), p, splat<V>(Lane<V>(bulk_modulus)));
    return modulus - smaller<V>(J * p, V{});
  }

  double kinematic_viscosity() const { return viscosity / density; }
  bool hyperelastic() const { return viscosity == 0; }

  template <class V>
  SUBSTEP_INLINE V pressure(const V& volume_ratio) const {
    using T = Lane<V>;
    const V J = compressed<V>(volume_ratio), valid = nan_unless<V>(J > 0);
    if (exponent == 1) return fma(T(bulk_modulus), (1 - J) / J, valid);
    const V power = exp<V>(T(-exponent) * log<V>(J) + valid);
    return T(bulk_modulus / exponent) * (power - 1);
  }

  // J as far as it resists.
  template <class V>
  SUBSTEP_INLINE V compressed(const V& J) const {
    return tension ? J : (J > 1 ? splat<V>(1) : J);
  }
};

}  // namespace substep::mpm
