// Metal-like and clay-like plasticity: Hencky elasticity with the yield surface of von Mises,
//   |dev tau| <= sqrt(2/3) (sigma_y + H a),
// a the equivalent plastic strain, and radial return (Simo and Hughes, "Computational
// Inelasticity", 1998, section 3.3, with K' = H, H' = 0, in logarithmic strains):
//   dg = (|dev tau_tr| - sqrt(2/3) (sigma_y + H a)) / (2 mu + 2/3 H),  a += sqrt(2/3) dg.
// sigma_y is what a tension test shows; pure shear yields at sigma_y / sqrt(3). Volume is elastic.
#pragma once

#include <cmath>

#include "substep/mpm/materials/hencky.h"

namespace substep::mpm {

struct VonMises {
  static constexpr const char* kName = "von_mises";
  static constexpr int kTogether = kSideBySide;
  static constexpr bool kHasF = true;  // F_E
  static constexpr bool kInverts = false, kAveragesVolume = true;
  static constexpr std::array<StateField, 1> kState{{{"plastic_strain", "1", 0.0}}};  // a
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;    // [kg/m^3], Lame's parameters [Pa]
  double yield_stress;           // sigma_y [Pa]
  double hardening_modulus = 0;  // H [Pa]

  template <class Constants>
  static VonMises with(const Constants& c) {
    return {.density = c("density"),
            .mu = c("mu"),
            .lambda = c("lambda"),
            .yield_stress = c("yield_stress"),
            .hardening_modulus = c("hardening_modulus")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    using T = Lane<V>;
    const T root = T(std::sqrt(2.0 / 3)), inverse = T(1 / (2 * mu + 2 * hardening_modulus / 3));
    Tensor<V, D> F[kPackets];
    HenckyStrain<V, D> trial[kPackets];
    for (int k = 0; k < kPackets; ++k) F[k] = Tensor<V, D>::load(fields[k]);
    HenckyStrain<V, D>::of(F, trial);
    for (int k = 0; k < kPackets; ++k) {
      V& a = fields[k][Tensor<V, D>::kEntries];
      const V size = T(2 * mu) * trial[k].deviator_norm();  // |dev tau_tr|
      const V over = size - root * fma(T(hardening_modulus), a, splat<V>(T(yield_stress)));
      const auto yields = over > 0;
      const V dg = yields ? over * inverse : V{};
      a = fma(root, dg, a);
      const V scale = yields ? 1 - T(2 * mu) * dg / size : splat<V>(1);
      tau[k] = trial[k].with_deviator_scaled(fields[k], F[k], scale, yields, T(mu), T(lambda));
    }
  }

  template <class V, int D>
  SUBSTEP_INLINE V energy_density(const V* fields) const {
    return hencky_energy(Tensor<V, D>::load(fields), Lane<V>(mu), Lane<V>(lambda));
  }

  template <class V, int D>
  SUBSTEP_INLINE V wave_modulus(const V*) const {
    return splat<V>(Lane<V>(lambda + 2 * mu));
  }

  double kinematic_viscosity() const { return 0; }
  bool hyperelastic() const { return false; }
};

}  // namespace substep::mpm
