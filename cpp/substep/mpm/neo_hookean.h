// Neo-Hookean elasticity, compressible: psi = mu/2 (tr b - 3) - mu ln J + lambda/4 (J^2 - 1 - 2 ln
// J), so tau = P F^T = mu (b - I) + lambda/2 (J^2 - 1) I with b = F F^T, J = det F. Simo and
// Hughes, "Computational Inelasticity", 1998, eq. 9.2.3 (with its U(J)).
#pragma once

#include "substep/core/log.h"
#include "substep/mpm/material.h"

namespace substep::mpm {

struct NeoHookean {
  static constexpr const char* kName = "neo_hookean";
  template <int D>
  static constexpr int kFields = Tensor<float, D>::kEntries;
  double density, mu, lambda;  // [kg/m^3], Lame's parameters [Pa]

  template <int D>
  void initial(double* F) const {
    for (int k = 0; k < kFields<D>; ++k) F[k] = 0;
    for (const int k : {0, D + 1, kFields<D> - 1}) F[k] = 1;
  }

  template <class V, int D>
  SUBSTEP_INLINE void advance(V* fields, const Tensor<V, D>& G, Lane<V> dt) const {
    advanced(Tensor<V, D>::load(fields), G, dt).store(fields);
  }

  template <class V, int D, int kPackets>
  SUBSTEP_INLINE void stress(V* const (&fields)[kPackets], const Tensor<V, D> (&)[kPackets],
                             Lane<V>, SymmetricTensor<V, D> (&tau)[kPackets]) const {
    for (int p = 0; p < kPackets; ++p) {
      const auto F = Tensor<V, D>::load(fields[p]);
      const V J = determinant(F);
      const V pressure = (J * J - 1) * static_cast<Lane<V>>(lambda / 2);
      tau[p] = left_cauchy_green(F);
      for (V& entry : tau[p].m) entry *= static_cast<Lane<V>>(mu);
      for (int d = 0; d < 3; ++d) tau[p].m[d] += pressure - static_cast<Lane<V>>(mu);
    }
  }
};

}  // namespace substep::mpm
