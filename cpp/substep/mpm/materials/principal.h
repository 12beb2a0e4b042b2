// Principal axes of symmetric tensors b = U diag(d) U^T, of several packets at once, since each
// rotation waits for the one before it and packets do not wait for each other.
//
// 3D: cyclic Jacobi, a fixed number of rotations without branches: NaN gives NaN, and a lane's bits
// do not depend on its neighbours. A rotation by phi in the plane of p and q with
//   tan(2 phi) = 2 b_pq / (b_qq - b_pp), |phi| <= pi/4,
// is (c, s) in the direction of (|delta| + h, +-2 b_pq), delta = b_qq - b_pp, h = sqrt(delta^2 +
// (2 b_pq)^2). So h may be an estimate (the next rotation in that plane removes what b_pq keeps),
// if only c^2 + s^2 = 1 to rounding: two inverse square roots, no division. McAdams, Selle,
// Tamstorf, Teran, Sifakis, "Computing the singular value decomposition of 3x3 matrices with
// minimal branching and elementary floating point operations", 2011, section 2, does so with
// quaternions.
#pragma once

#include "substep/core/roots.h"
#include "substep/mpm/materials/tensor.h"

namespace substep::mpm {

// In 2D, U is the rotation by phi in the plane, columns (c, -s) and (s, c): U[0] = c, U[1] = s.
template <class V, int D>
struct Principal {
  V d[3];
  V U[D == 3 ? 9 : 2];  // 3D: row by row; columns are the axes
};

namespace detail {

// (c, s) = (x, y) / |(x, y)| to rounding: inverse_root (core/roots.h), whose last step is made on c
// and s, which need not wait for it.
template <class V>
SUBSTEP_INLINE void normalize(const V& x, const V& y, V& c, V& s) {
  const V square = fma<V>(x, x, y * y);
  if constexpr (sizeof(Lane<V>) == 8) {
    const V scale = inverse_root<V>(square);
    c = x * scale, s = y * scale;
  } else {
    const V scale = inverse_sqrt_estimate<V>(square),
            e = fma<V>(-square * scale, scale, splat<V>(1));
    c = x * scale, s = y * scale;
    if constexpr (sizeof(V) == 64) {  // 14 bits
      c = fma<V>(0.5f * c, e, c), s = fma<V>(0.5f * s, e, s);
    } else {
      const V correction = e * fma(0.375f, e, splat<V>(0.5f));
      c = fma<V>(c, correction, c), s = fma<V>(s, correction, s);
    }
  }
}

// Rotation that makes b_pq vanish, or nearly: c, s and the new b_pp, b_qq, b_pq.
template <bool kExact, class V>
SUBSTEP_INLINE void jacobi_rotation(V& pp, V& qq, V& pq, V& c, V& s) {
  using I = std::remove_cvref_t<decltype(pp < pp)>;
  const I sign_bit = reinterpret_cast<I>(splat<V>(Lane<V>(-0.0)));
  const V delta = qq - pp, twice = pq + pq;
  const V square = fma<V>(delta, delta, fma(twice, twice, Lane<V>(1e-30)));
  const I sign = reinterpret_cast<I>(delta) & sign_bit;
  const V size = reinterpret_cast<V>(reinterpret_cast<I>(delta) ^ sign);  // |delta|
  const V x =
      kExact ? size + sqrt<V>(square) : fma<V>(square, inverse_sqrt_estimate<V>(square), size);
  const V y = reinterpret_cast<V>(reinterpret_cast<I>(twice) ^ sign);
  normalize(x, y, c, s);
  const V moved = s * fma<V>(s, delta, -c * twice);
  pp += moved;
  qq -= moved;
  pq = fma<V>(-s, fma<V>(s, twice, c * delta), pq);
}

template <class V>
SUBSTEP_INLINE void rotate(V& p, V& q, const V& c, const V& s) {
  const V a = p;
  p = fma<V>(c, a, -s * q);
  q = fma<V>(s, a, c * q);
}

}  // namespace detail

// Packets whose axes are found side by side: those of one wait for their own results, those of two
// need the registers of AVX-512.
inline constexpr int kSideBySide = kVectorBytes == 64 ? 2 : 1;

// Rotations after which the rest is below rounding: of 2.6e6 random tensors b of deformations up to
// twice the size, U diag(d) U^T is within 1.6e-6 of the largest d (float; 2e-5 after 9) or 4e-15
// (double; 2e-10 after 12).
template <class Real>
inline constexpr int kRotations = sizeof(Real) == 8 ? 15 : 10;

template <class V, int kPackets>
SUBSTEP_INLINE void principal_axes(const SymmetricTensor<V, 3> (&b)[kPackets],
                                   Principal<V, 3> (&axes)[kPackets]) {
  V xy[kPackets], xz[kPackets], yz[kPackets];
  for (int k = 0; k < kPackets; ++k) {
    auto& [d, U] = axes[k];
    for (int i = 0; i < 3; ++i) d[i] = b[k].m[i];
    xy[k] = b[k].m[3], xz[k] = b[k].m[4], yz[k] = b[k].m[5];
    // The first two rotations, of U = I, in the planes of x and y, x and z.
    V c, s, c2, s2;
    detail::jacobi_rotation<false>(d[0], d[1], xy[k], c, s);
    detail::rotate(xz[k], yz[k], c, s);
    detail::jacobi_rotation<false>(d[0], d[2], xz[k], c2, s2);
    detail::rotate(xy[k], yz[k], c2, s2);
    U[0] = c * c2, U[1] = s, U[2] = c * s2;
    U[3] = -s * c2, U[4] = c, U[5] = -s * s2;
    U[6] = -s2, U[7] = V{}, U[8] = c2;
  }
#pragma GCC unroll 18
  for (int rotation = 2; rotation < kRotations<Lane<V>>; ++rotation) {
    // Planes of x and y, x and z, y and z in turn; r is the third axis.
    const int p = rotation % 3 == 2 ? 1 : 0, q = rotation % 3 == 0 ? 1 : 2;
    for (int k = 0; k < kPackets; ++k) {
      auto& [d, U] = axes[k];
      V& pq = q == 1 ? xy[k] : (p == 0 ? xz[k] : yz[k]);
      V& rp = q == 1 ? xz[k] : xy[k];
      V& rq = q == 1 || p == 0 ? yz[k] : xz[k];
      V c, s;
      detail::jacobi_rotation<false>(d[p], d[q], pq, c, s);
      detail::rotate(rp, rq, c, s);
      for (int i = 0; i < 3; ++i) detail::rotate(U[3 * i + p], U[3 * i + q], c, s);
    }
  }
}

// In closed form: one rotation.
template <class V, int kPackets>
SUBSTEP_INLINE void principal_axes(const SymmetricTensor<V, 2> (&b)[kPackets],
                                   Principal<V, 2> (&axes)[kPackets]) {
  for (int k = 0; k < kPackets; ++k) {
    for (int i = 0; i < 3; ++i) axes[k].d[i] = b[k].m[i];
    V xy = b[k].m[3];
    detail::jacobi_rotation<true>(axes[k].d[0], axes[k].d[1], xy, axes[k].U[0], axes[k].U[1]);
  }
}

// U diag(t) U^T.
template <class V>
SUBSTEP_INLINE SymmetricTensor<V, 3> in_axes(const Principal<V, 3>& axes, const V (&t)[3]) {
  const V* U = axes.U;
  V Ut[9];
  for (int i = 0; i < 9; ++i) Ut[i] = U[i] * t[i % 3];
  const auto entry = [&](int i, int j) {
    return fma<V>(Ut[3 * i], U[3 * j],
                  fma<V>(Ut[3 * i + 1], U[3 * j + 1], Ut[3 * i + 2] * U[3 * j + 2]));
  };
  return {{entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)}};
}
template <class V>
SUBSTEP_INLINE SymmetricTensor<V, 2> in_axes(const Principal<V, 2>& axes, const V (&t)[3]) {
  const V c = axes.U[0], s = axes.U[1], moved = s * s * (t[1] - t[0]);
  return {{t[0] + moved, t[1] - moved, t[2], c * s * (t[1] - t[0])}};
}

}  // namespace substep::mpm
