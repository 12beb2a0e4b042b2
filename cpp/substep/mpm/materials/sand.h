// Dry sand: Hencky elasticity with the yield surface of Drucker and Prager and plastic flow along
// the deviator (no dilatancy). Klar, Gast, Pradhana, Fu, Schroeder, Jiang, Teran, "Drucker-Prager
// elastoplasticity for sand animation", 2016, and its technical document. With eps = strain, e =
// dev eps, t = tr eps:
//   |e| + alpha (3 lambda + 2 mu) / (2 mu) t <= 0, that is |dev tau| <= 3 alpha p,
// and the return map
//   t >= 0:                 no stress, eps = 0 (tensile apex);
//   |e| above the surface:  |e| goes to the surface, t stays.
//
// Volume correction, Tampubolon et al., "Multi-species simulation of porous sand and water
// mixtures", 2017: what the apex takes off t is kept as v_c, log of the volume gained, and added to
// the next trial strain (v_c / 3 each), so that grains that come together again do not resist
// before the gap has closed.
//
// Hardening of the friction angle (Klar et al., "Hardening"): with q, the plastic strain so far,
//   phi = phi_0 + (h_1 q - h_3) exp(-h_2 q); h_1 = h_3 = 0 is without. (h_0 = phi_0.)
// phi is kept between 0 and pi/2.
#pragma once

#include <cmath>
#include <numbers>

#include "substep/mpm/materials/hencky.h"

namespace substep::mpm {

// alpha of a friction angle [rad]: the cone that touches Mohr and Coulomb's pyramid in triaxial
// compression (its outer edges, as Klar et al. do), or meets it in plane strain at constant
// volume, where |dev tau| = sqrt(2) p sin phi.
enum class FrictionMatch { kCompression, kPlaneStrain };

struct Sand {
  static constexpr const char* kName = "sand";
  static constexpr int kTogether = kSideBySide;
  static constexpr bool kHasF = true;  // F_E
  static constexpr bool kInverts = false;
  static constexpr std::array<StateField, 2> kState{
      {{"volume_correction", "1", 0.0}, {"plastic_strain", "1", 0.0}}};  // v_c, q
  template <int D>
  static constexpr int kFields = number_of_fields<D>(kHasF, kState);
  double density, mu, lambda;                    // [kg/m^3], Lame's parameters [Pa]
  double friction_angle = std::numbers::pi / 6;  // phi_0 [rad]
  FrictionMatch match = FrictionMatch::kCompression;
  double hardening_slope = 0, hardening_rate = 0, initial_softening = 0;  // h_1, h_2, h_3

  template <class Constants>
  static Sand with(const Constants& c) {
    return {
        .density = c("density"),
        .mu = c("mu"),
        .lambda = c("lambda"),
        .friction_angle = c("friction_angle"),
        .match = c("plane_strain") != 0 ? FrictionMatch::kPlaneStrain : FrictionMatch::kCompression,
        .hardening_slope = c("hardening_slope"),
        .hardening_rate = c("hardening_rate"),
        .initial_softening = c("initial_softening")};
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    constexpr int kOwn = Tensor<V, D>::kEntries;
    using T = Lane<V>;
    Tensor<V, D> F[kPackets];
    HenckyStrain<V, D> trial[kPackets];
    for (int k = 0; k < kPackets; ++k) F[k] = Tensor<V, D>::load(fields[k]);
    HenckyStrain<V, D>::of(F, trial);
    for (int k = 0; k < kPackets; ++k) {
      V &v_c = fields[k][kOwn], &q = fields[k][kOwn + 1];
      const V t = trial[k].trace() + v_c, mean = t * T(1.0 / 3);
      const V shift = v_c * T(1.0 / 3);
      V e[3], eps[3];
      for (int i = 0; i < 3; ++i) e[i] = trial[k].eps[i] + shift - mean;
      const V square = fma<V>(e[0], e[0], fma<V>(e[1], e[1], e[2] * e[2]));
      const V norm = sqrt<V>(square);
      // |e| on the surface, above 0 where t < 0.
      const V surface = slope<V>(q) * -t;
      const auto apex = t >= 0;
      const auto shears = ~apex & (norm > surface);
      const V scale = shears ? surface / norm : (apex ? V{} : splat<V>(T(1)));
      const V kept = apex ? V{} : mean;
      for (int i = 0; i < 3; ++i) eps[i] = fma<V>(scale, e[i], kept);
      const auto changes = apex | shears | (v_c != 0);
      if (any(changes)) {
        V change[3];
        for (int i = 0; i < 3; ++i) change[i] = eps[i] - trial[k].eps[i];
        const auto to_surface = trial[k].moved(F[k], change);
        for (int i = 0; i < kOwn; ++i) fields[k][i] = changes ? to_surface.m[i] : F[k].m[i];
        v_c = apex ? t : V{};
        // All the strain at the apex, what the deviator loses above the surface.
        const V lost = trial[k].trace();
        q += apex ? sqrt<V>(fma<V>(lost * T(1.0 / 3), lost, square))
                  : (shears ? norm - surface : V{});
      }
      tau[k] = trial[k].stress(eps, T(mu), T(lambda));
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

  // alpha (3 lambda + 2 mu) / (2 mu) of the friction angle after the plastic strain q.
  template <class V>
  SUBSTEP_INLINE V slope(const V& q) const {
    using T = Lane<V>;
    const bool compression = match == FrictionMatch::kCompression;
    const double scale =
        (compression ? std::sqrt(8.0 / 3) : std::numbers::sqrt2) * (3 * lambda + 2 * mu) / (2 * mu);
    const double outer = compression ? 1 : 0;
    if (hardening_slope == 0 && initial_softening == 0) {
      const double sine = std::sin(friction_angle);
      return splat<V>(T(scale * sine / (3 - outer * sine)));
    }
    const V linear = fma(T(hardening_slope), q, splat<V>(T(-initial_softening)));
    V phi = fma<V>(linear, exp<V>(T(-hardening_rate) * q), splat<V>(T(friction_angle)));
    phi = phi < 0 ? V{} : phi;
    phi = phi > T(std::numbers::pi / 2) ? splat<V>(T(std::numbers::pi / 2)) : phi;
    const V sine = quarter_sine<V>(phi);
    return T(scale) * sine / (3 - T(outer) * sine);
  }

  // sin(x), 0 <= x <= pi/2: its series to x^21.
  template <class V>
  static SUBSTEP_INLINE V quarter_sine(const V& x) {
    const V minus_square = -x * x;
    V sum = splat<V>(1);
    for (int k = 20; k > 0; k -= 2) {
      sum = fma<V>(minus_square * Lane<V>(1.0 / (k * (k + 1))), sum, splat<V>(1));
    }
    return x * sum;
  }
};

}  // namespace substep::mpm
