// Rotations by unit quaternions in lanes, as quaternion.h has them one by one.
#pragma once

#include "substep/core/atan2.h"
#include "substep/core/matrix3.h"
#include "substep/core/sincos.h"

namespace substep {

template <class V>
struct QuaternionLanes {
  V w;
  Vector3<V> v;

  SUBSTEP_INLINE QuaternionLanes operator*(const QuaternionLanes& r) const {
    return {w * r.w - dot(v, r.v), w * r.v + r.w * v + cross(v, r.v)};
  }
  SUBSTEP_INLINE QuaternionLanes conjugate() const { return {w, {{-v[0], -v[1], -v[2]}}}; }
  SUBSTEP_INLINE Vector3<V> rotated(const Vector3<V>& x) const {
    const Vector3<V> t = splat<V>(2) * cross(v, x);
    return x + w * t + cross(v, t);
  }
  // Of the matrix.
  SUBSTEP_INLINE Vector3<V> column(int i) const {
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    Vector3<V> c;
    c[i] = 1.0 - 2.0 * (v[j] * v[j] + v[k] * v[k]);
    c[j] = 2.0 * (v[i] * v[j] + w * v[k]);
    c[k] = 2.0 * (v[i] * v[k] - w * v[j]);
    return c;
  }
};

template <class V>
SUBSTEP_INLINE QuaternionLanes<V> rotation_by(const Vector3<V>& a) {
  const V square = dot(a, a), angle = square_root(square);
  V sine, cosine;
  Sincos<V>{}(0.5 * angle, sine, cosine);
  const auto large = angle > 1e-4;
  const V scale = select(large, sine / select(large, angle, splat<V>(1)), 0.5 - square / 48.0);
  return {cosine, scale * a};
}

template <class V>
SUBSTEP_INLINE Vector3<V> rotation_vector(const QuaternionLanes<V>& q) {
  const V square = dot(q.v, q.v), sine = square_root(square);
  const auto large = sine > 1e-4, negative = q.w < 0.0;
  const V half = atan2<V>(sine, select(negative, V(-q.w), q.w));
  const V scale =
      select(large, 2.0 * half / select(large, sine, splat<V>(1)), 2.0 + square * (1.0 / 3));
  return select(negative, V(-scale), scale) * q.v;
}

}  // namespace substep
