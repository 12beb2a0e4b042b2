// What plastic materials of Hencky elasticity share: psi = mu tr(eps^2) + lambda/2 (tr eps)^2 of
// the logarithmic strain, eps_i = ln sigma_i in principal axes, so tau_i = 2 mu eps_i + lambda tr
// eps (Hencky, 1928; as in Klar et al., "Drucker-Prager elastoplasticity for sand animation",
// 2016). A return map scales the deviator of eps, so F_E only changes along its axes: F_E <- U
// exp(eps - eps_tr) U^T F_E.
#pragma once

#include "substep/core/exp.h"
#include "substep/core/log.h"
#include "substep/mpm/materials/material.h"
#include "substep/mpm/materials/principal.h"

namespace substep::mpm {

// Principal strains of F and its axes. NaN unless det F > 0 and the stretches are from 1e-3 to 1e3.
template <class V, int D>
struct HenckyStrain {
  Principal<V, D> axes;
  V eps[3];  // trial strain, before the return map

  template <int kPackets>
  static SUBSTEP_INLINE void of(const Tensor<V, D> (&F)[kPackets],
                                HenckyStrain (&strain)[kPackets]) {
    SymmetricTensor<V, D> b[kPackets];
    Principal<V, D> all[kPackets];
    for (int k = 0; k < kPackets; ++k) b[k] = left_cauchy_green(F[k]);
    principal_axes(b, all);
    for (int k = 0; k < kPackets; ++k) {
      const V(&d)[3] = all[k].d;
      const V low = smaller<V>(smaller<V>(d[0], d[1]), d[2]);
      const V high = larger<V>(larger<V>(d[0], d[1]), d[2]);
      const V valid =
          nan_unless<V>((determinant(F[k]) > 0) & (low >= Lane<V>(1e-6)) & (high <= Lane<V>(1e6)));
      for (int i = 0; i < 3; ++i) {
        strain[k].eps[i] = fma(Lane<V>(0.5), log<V>(d[i]), valid);
      }
      strain[k].axes = all[k];
    }
  }

  SUBSTEP_INLINE V trace() const { return eps[0] + eps[1] + eps[2]; }

  // |eps - tr eps / 3|.
  SUBSTEP_INLINE V deviator_norm() const {
    const V mean = trace() * Lane<V>(1.0 / 3);
    const V e[3] = {eps[0] - mean, eps[1] - mean, eps[2] - mean};
    return sqrt<V>(fma<V>(e[0], e[0], fma<V>(e[1], e[1], e[2] * e[2])));
  }

  // F of the strain eps + change. What is added is small, so the rounding of the axes is too.
  SUBSTEP_INLINE Tensor<V, D> moved(const Tensor<V, D>& F, const V (&change)[3]) const {
    V relative[3];
    for (int i = 0; i < 3; ++i) relative[i] = exp<V>(change[i]) - 1;
    Tensor<V, D> sum = in_axes(axes, relative) * F;
    for (int i = 0; i < F.kEntries; ++i) sum.m[i] += F.m[i];
    return sum;
  }

  SUBSTEP_INLINE SymmetricTensor<V, D> stress(const V (&strain)[3], Lane<V> mu,
                                              Lane<V> lambda) const {
    const V spherical = lambda * (strain[0] + strain[1] + strain[2]);
    V t[3];
    for (int i = 0; i < 3; ++i) t[i] = fma(2 * mu, strain[i], spherical);
    return in_axes(axes, t);
  }

  // A radial return: tau with the deviator of eps times `scale`; F goes there in the lanes that
  // yield.
  template <class Mask>
  SUBSTEP_INLINE SymmetricTensor<V, D> with_deviator_scaled(V* fields, const Tensor<V, D>& F,
                                                            const V& scale, const Mask& yields,
                                                            Lane<V> mu, Lane<V> lambda) const {
    const V mean = trace() * Lane<V>(1.0 / 3);
    V strain[3], change[3];
    for (int i = 0; i < 3; ++i) {
      change[i] = (scale - 1) * (eps[i] - mean);
      strain[i] = eps[i] + change[i];
    }
    if (any(yields)) {
      const auto returned = moved(F, change);
      for (int i = 0; i < F.kEntries; ++i) fields[i] = yields ? returned.m[i] : F.m[i];
    }
    return stress(strain, mu, lambda);
  }
};

template <class V, int D>
SUBSTEP_INLINE V hencky_energy(const Tensor<V, D>& F, Lane<V> mu, Lane<V> lambda) {
  const Tensor<V, D> one[1] = {F};
  HenckyStrain<V, D> strain[1];
  HenckyStrain<V, D>::of(one, strain);
  const V(&e)[3] = strain[0].eps;
  const V trace = strain[0].trace();
  return mu * (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]) + lambda / 2 * (trace * trace);
}

}  // namespace substep::mpm
