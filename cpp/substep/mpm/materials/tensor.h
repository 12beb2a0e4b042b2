// Tensors over a vector of lanes V (core/lanes.h), in 3D or in plane strain: there zz is the
// stretch out of the plane, so that a material writes its formulas once, in three dimensions.
#pragma once

#include "substep/core/lanes.h"

namespace substep::mpm {

// General tensor: F, grad v. 3D: rows xx xy xz, yx yy yz, zx zy zz. 2D: xx xy, yx yy, and zz.
template <class V, int kDimension>
struct Tensor {
  static constexpr int kEntries = kDimension == 3 ? 9 : 5;
  V m[kEntries];

  static SUBSTEP_INLINE Tensor identity() {
    Tensor I{};
    for (int d = 0; d < 3; ++d) I.diagonal(d) = splat<V>(1);
    return I;
  }
  // The entries as fields of a packet.
  static SUBSTEP_INLINE Tensor load(const V* fields) {
    Tensor A;
    for (int k = 0; k < kEntries; ++k) A.m[k] = fields[k];
    return A;
  }
  SUBSTEP_INLINE void store(V* fields) const {
    for (int k = 0; k < kEntries; ++k) fields[k] = m[k];
  }
  // Entry (i, j) with i, j < kDimension.
  SUBSTEP_INLINE V& operator()(int i, int j) { return m[i * kDimension + j]; }
  SUBSTEP_INLINE const V& operator()(int i, int j) const { return m[i * kDimension + j]; }
  // xx, yy, zz.
  SUBSTEP_INLINE V& diagonal(int d) { return m[kDimension == 3 ? 4 * d : (d == 2 ? 4 : 3 * d)]; }
  SUBSTEP_INLINE const V& diagonal(int d) const {
    return m[kDimension == 3 ? 4 * d : (d == 2 ? 4 : 3 * d)];
  }
};

// Symmetric tensor: tau, b. 3D: xx yy zz xy xz yz. 2D: xx yy zz xy.
template <class V, int kDimension>
struct SymmetricTensor {
  static constexpr int kEntries = kDimension == 3 ? 6 : 4;
  V m[kEntries];

  // Entry (i, j) with i, j < kDimension.
  SUBSTEP_INLINE V& operator()(int i, int j) {
    return m[i == j ? i : (kDimension == 3 ? i + j + 2 : 3)];
  }
  SUBSTEP_INLINE const V& operator()(int i, int j) const {
    return m[i == j ? i : (kDimension == 3 ? i + j + 2 : 3)];
  }
  SUBSTEP_INLINE V trace() const { return m[0] + m[1] + m[2]; }
};

template <class V, int kDimension>
SUBSTEP_INLINE V trace(const Tensor<V, kDimension>& A) {
  return A.diagonal(0) + A.diagonal(1) + A.diagonal(2);
}

template <class V>
SUBSTEP_INLINE V determinant(const Tensor<V, 3>& A) {
  return A.m[0] * (A.m[4] * A.m[8] - A.m[5] * A.m[7]) -
         A.m[1] * (A.m[3] * A.m[8] - A.m[5] * A.m[6]) +
         A.m[2] * (A.m[3] * A.m[7] - A.m[4] * A.m[6]);
}
template <class V>
SUBSTEP_INLINE V determinant(const Tensor<V, 2>& A) {
  return (A.m[0] * A.m[3] - A.m[1] * A.m[2]) * A.m[4];
}

// (I + h G) F.
template <class V>
SUBSTEP_INLINE Tensor<V, 3> advanced(const Tensor<V, 3>& F, const Tensor<V, 3>& G, Lane<V> h) {
  Tensor<V, 3> A;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const V GF = fma(G(i, 0), F(0, j), fma(G(i, 1), F(1, j), G(i, 2) * F(2, j)));
      A(i, j) = fma(h, GF, F(i, j));
    }
  }
  return A;
}
template <class V>
SUBSTEP_INLINE Tensor<V, 2> advanced(const Tensor<V, 2>& F, const Tensor<V, 2>& G, Lane<V> h) {
  Tensor<V, 2> A;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      A(i, j) = fma(h, fma(G(i, 0), F(0, j), G(i, 1) * F(1, j)), F(i, j));
    }
  }
  A.m[4] = fma(h, G.m[4] * F.m[4], F.m[4]);
  return A;
}

// b = F F^T.
template <class V>
SUBSTEP_INLINE SymmetricTensor<V, 3> left_cauchy_green(const Tensor<V, 3>& F) {
  const auto row = [&](int i, int j) {
    return fma(F(i, 0), F(j, 0), fma(F(i, 1), F(j, 1), F(i, 2) * F(j, 2)));
  };
  return {{row(0, 0), row(1, 1), row(2, 2), row(0, 1), row(0, 2), row(1, 2)}};
}
template <class V>
SUBSTEP_INLINE SymmetricTensor<V, 2> left_cauchy_green(const Tensor<V, 2>& F) {
  const auto row = [&](int i, int j) { return fma(F(i, 0), F(j, 0), F(i, 1) * F(j, 1)); };
  return {{row(0, 0), row(1, 1), F.m[4] * F.m[4], row(0, 1)}};
}

// A F.
template <class V>
SUBSTEP_INLINE Tensor<V, 3> operator*(const SymmetricTensor<V, 3>& A, const Tensor<V, 3>& F) {
  Tensor<V, 3> AF;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      AF(i, j) = fma<V>(A(i, 0), F(0, j), fma<V>(A(i, 1), F(1, j), A(i, 2) * F(2, j)));
    }
  }
  return AF;
}
template <class V>
SUBSTEP_INLINE Tensor<V, 2> operator*(const SymmetricTensor<V, 2>& A, const Tensor<V, 2>& F) {
  Tensor<V, 2> AF;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) AF(i, j) = fma<V>(A(i, 0), F(0, j), A(i, 1) * F(1, j));
  }
  AF.m[4] = A.m[2] * F.m[4];
  return AF;
}

}  // namespace substep::mpm
