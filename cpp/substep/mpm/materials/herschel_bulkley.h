// Mud, paste, foam: Hencky elasticity that flows above a yield stress. With the shear stress s =
// |dev tau| / sqrt(2) and the plastic shear rate g = sqrt(2) |D_p| along dev tau,
//   s <= tau_y: no flow;   s > tau_y: s = tau_y + K g^n,
// Herschel and Bulkley, 1926 (n = 1: Bingham), in three dimensions as in Oldroyd, 1947. As in Yue,
// Smith, Batty, Zheng, Grinspun, "Continuum foam: a material point method for shear-dependent
// flows", 2015, flow relaxes the elastic strain; there the strain is b, so that the shear modulus
// depends on its trace; here it is ln sigma, whose deviator simply shrinks (dev tau = 2 mu dev eps,
// implicit Euler):
//   s = s_tr - mu dt g.
// So steady simple shear has g = the shear rate and s = tau_y + K g^n, whatever dt is, up to
// (s / mu)^2. Volume is elastic.
//
// Both laws give g: with A = s_tr - tau_y > 0, K g^n + mu dt g = A. In u = ln g the function
//   f(u) = ln(K/A exp(n u) + mu dt/A exp(u)),  f' from min(n, 1) to max(n, 1),
// is convex, and not below 0 where the larger term is 1, so Newton's method goes from there to the
// root without overshooting. n = 1 needs no iteration.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>

#include "substep/mpm/materials/hencky.h"

namespace substep::mpm {

struct HerschelBulkley {
  static constexpr const char* kName = "herschel_bulkley";
  static constexpr int kTogether = kSideBySide;
  static constexpr bool kHasF = true;  // F_E
  static constexpr bool kInverts = false, kAveragesVolume = true;
  // The integral of g.
  static constexpr std::array<StateField, 1> kState{{{"plastic_strain", "1", 0.0}}};
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;  // [kg/m^3], Lame's parameters [Pa]
  double yield_stress;         // tau_y, in shear [Pa]
  double consistency;          // K > 0 [Pa s^n]
  double flow_index = 1;       // n, 0.1 to 2

  template <class Constants>
  static HerschelBulkley with(const Constants& c) {
    return {.density = c("density"),
            .mu = c("mu"),
            .lambda = c("lambda"),
            .yield_stress = c("yield_stress"),
            .consistency = c("consistency"),
            .flow_index = c("flow_index")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V> dt, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    using T = Lane<V>;
    Tensor<V, D> F[kPackets];
    HenckyStrain<V, D> trial[kPackets];
    for (int k = 0; k < kPackets; ++k) F[k] = Tensor<V, D>::load(fields[k]);
    HenckyStrain<V, D>::of(F, trial);
    for (int k = 0; k < kPackets; ++k) {
      V& strain = fields[k][Tensor<V, D>::kEntries];
      const V s = T(mu * std::numbers::sqrt2) * trial[k].deviator_norm();  // s_tr
      const V over = s - T(yield_stress);                                  // A
      const auto yields = over > 0;
      V scale = splat<V>(1);
      if (any(yields)) {
        const V lost = over * (1 - viscous_share<V>(yields ? over : splat<V>(1), dt));
        scale = yields ? 1 - lost / s : scale;
        strain += yields ? lost * T(1 / mu) : V{};
      }
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

  // K g^n / A; the rest of A, mu dt g, is what the step relaxes.
  template <class V>
  SUBSTEP_INLINE V viscous_share(const V& A, Lane<V> dt) const {
    using T = Lane<V>;
    const double elastic = std::max(mu * static_cast<double>(dt), 1e-30);  // mu dt
    if (flow_index == 1) return splat<V>(T(consistency / (consistency + elastic)));
    const T n = T(flow_index);
    const V ln_A = log<V>(A);
    const V viscous = T(std::log(consistency)) - ln_A, relaxed = T(std::log(elastic)) - ln_A;
    V u = smaller<V>(-viscous * T(1 / flow_index), -relaxed);
    V share{};
    constexpr int kSteps = sizeof(T) == 8 ? 6 : 5;  // to rounding, for n from 0.1 to 2
    for (int step = 0; step < kSteps; ++step) {
      const V a = exp<V>(fma(n, u, viscous)), b = exp<V>(u + relaxed), sum = a + b;
      share = a / sum;
      u -= log<V>(sum) / fma(n - 1, share, splat<V>(1));  // f' = n share + (1 - share)
    }
    return share;
  }
};

}  // namespace substep::mpm
