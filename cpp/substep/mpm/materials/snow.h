// Snow: fixed-corotated elasticity of F_E, which hardens with plastic compression; the singular
// values of F_E stay between 1 - theta_c and 1 + theta_s. Stomakhin, Schroeder, Chai, Teran,
// Selle, "A material point method for snow simulation", 2013, section 5:
//   psi = h (mu |F_E - R_E|^2 + lambda/2 (J_E - 1)^2), h = exp(xi (1 - J_P))       (eqs. 1, 2)
//   F = F_E F_P, J_P = det F_P: what the clamp takes off F_E goes to F_P           (section 7)
// Of F_P only its determinant matters. Singular values of F_E are the roots of the eigenvalues of
// b = F_E F_E^T, the smallest one with the sign of det F_E, as in fixed_corotated.h.
//
// No answer where a singular value is below 1e-3, since F_E has then lost its axis.
//
// Deviation: h is bounded by largest_hardening, so that xi (1 - J_P) cannot overflow, and J_P stays
// between 1e-6 and 1e6.
#pragma once

#include <cmath>

#include "substep/core/exp.h"
#include "substep/mpm/materials/fixed_corotated.h"

namespace substep::mpm {

struct Snow {
  static constexpr const char* kName = "snow";
  static constexpr int kTogether = kSideBySide;
  static constexpr bool kHasF = true;  // F_E
  static constexpr bool kInverts = true;
  static constexpr std::array<StateField, 1> kState{{{"plastic_volume_ratio", "1", 1.0}}};  // J_P
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;  // [kg/m^3], Lame's parameters at J_P = 1 [Pa]
  double critical_compression = 2.5e-2, critical_stretch = 7.5e-3;  // theta_c, theta_s
  double hardening = 10;                                            // xi
  double largest_hardening = 100;                                   // bound of h

  template <class Constants>
  static Snow with(const Constants& c) {
    return {.density = c("density"),
            .mu = c("mu"),
            .lambda = c("lambda"),
            .critical_compression = c("critical_compression"),
            .critical_stretch = c("critical_stretch"),
            .hardening = c("hardening"),
            .largest_hardening = c("largest_hardening")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    const V low = splat<V>(Lane<V>(1 - critical_compression));
    const V high = splat<V>(Lane<V>(1 + critical_stretch));
    Tensor<V, D> F[kPackets];
    SymmetricTensor<V, D> b[kPackets];
    Principal<V, D> axes[kPackets];
    for (int k = 0; k < kPackets; ++k) {
      F[k] = Tensor<V, D>::load(fields[k]);
      b[k] = left_cauchy_green(F[k]);
    }
    principal_axes(b, axes);
    for (int k = 0; k < kPackets; ++k) {
      V inverse[3], sigma[3], change[3], t[3];
      signed_stretches(axes[k].d, determinant(F[k]), sigma, inverse);
      const V J_trial = sigma[0] * sigma[1] * sigma[2];
      const auto yields = (smaller<V>(smaller<V>(sigma[0], sigma[1]), sigma[2]) < low) |
                          (larger<V>(larger<V>(sigma[0], sigma[1]), sigma[2]) > high);
      V& J_P = fields[k][Tensor<V, D>::kEntries];
      if (any(yields)) {
        for (int i = 0; i < 3; ++i) {
          // NaN stays: comparisons with it are false.
          V clamped = sigma[i] < low ? low : sigma[i];
          clamped = clamped > high ? high : clamped;
          change[i] = (clamped - sigma[i]) * inverse[i];
          sigma[i] = clamped;
        }
        const auto change_of_F = in_axes(axes[k], change) * F[k];
        for (int i = 0; i < Tensor<V, D>::kEntries; ++i) {
          fields[k][i] = yields ? F[k].m[i] + change_of_F.m[i] : F[k].m[i];
        }
        V product = J_P * (J_trial / (sigma[0] * sigma[1] * sigma[2]));
        product = product < Lane<V>(1e-6) ? splat<V>(Lane<V>(1e-6)) : product;
        product = product > Lane<V>(1e6) ? splat<V>(Lane<V>(1e6)) : product;
        J_P = yields ? product : J_P;
      }
      const V(&d)[3] = axes[k].d;
      const V valid = nan_unless<V>(smaller<V>(smaller<V>(d[0], d[1]), d[2]) >= Lane<V>(1e-6));
      const V h = hardening_factor<V>(J_P) + valid, J = sigma[0] * sigma[1] * sigma[2];
      corotated_stress(sigma, J, h * Lane<V>(mu), h * Lane<V>(lambda), t);
      tau[k] = in_axes(axes[k], t);
    }
  }

  template <class V, int D>
  SUBSTEP_INLINE V energy_density(const V* fields) const {
    return hardening_factor<V>(fields[Tensor<V, D>::kEntries]) *
           corotated_energy(Tensor<V, D>::load(fields), Lane<V>(mu), Lane<V>(lambda));
  }

  template <class V, int D>
  SUBSTEP_INLINE V wave_modulus(const V* fields) const {
    return hardening_factor<V>(fields[Tensor<V, D>::kEntries]) *
           corotated_modulus(Tensor<V, D>::load(fields), Lane<V>(mu), Lane<V>(lambda));
  }

  double kinematic_viscosity() const { return 0; }
  bool hyperelastic() const { return false; }

  template <class V>
  SUBSTEP_INLINE V hardening_factor(const V& J_P) const {
    const V exponent = Lane<V>(hardening) * (1 - J_P);
    const V bound = splat<V>(Lane<V>(std::log(largest_hardening)));
    return exp<V>(exponent > bound ? bound : exponent);
  }
};

}  // namespace substep::mpm
