// The splitting of the free rotation (free_rotation.h) for lanes of bodies.
//
// T = |m|^2 / (2 I_2) + sum over i = 1, 3 of (1 / I_i - 1 / I_2) m_i^2 / 2, I_1 <= I_2 <= I_3. The
// first term turns the body about L and commutes with the rest; the other two turn it about its own
// axes: Strang's splitting of the latter (Touma and Wisdom 1994, "Lie-Poisson integrators for rigid
// body dynamics in the solar system", Astron. J. 107, section 3; Dullweber, Leimkuhler and
// McLachlan 1997, "Symplectic splitting methods for rigid body molecular dynamics", J. Chem. Phys.
// 107, split off three axes). Exact for symmetric bodies.
#pragma once

#include "substep/core/quaternion_lanes.h"

namespace substep::rigid {

namespace detail {

// Where the moment I of axis a is greater than that of b, turns the frame by a quarter such that b
// comes first: (x_a, x_b) to (x_b, -x_a).
template <class V, class Mask>
SUBSTEP_INLINE void turn_frame(const Mask& mask, Vector3<V>& x, int a, int b) {
  const V first = x[a];
  x[a] = select(mask, x[b], x[a]);
  x[b] = select(mask, -first, x[b]);
}
template <class V, class Mask>
SUBSTEP_INLINE void turn_frame_back(const Mask& mask, Vector3<V>& x, int a, int b) {
  const V first = x[a];
  x[a] = select(mask, -x[b], x[a]);
  x[b] = select(mask, first, x[b]);
}
template <class V, class Mask>
SUBSTEP_INLINE void exchange(const Mask& mask, Vector3<V>& x, int a, int b) {
  const V first = x[a];
  x[a] = select(mask, x[b], x[a]);
  x[b] = select(mask, first, x[b]);
}

}  // namespace detail

// q after dt. Bodies with L = 0 keep the bits of q.
template <class V>
SUBSTEP_INLINE QuaternionLanes<V> split_rotation(const QuaternionLanes<V>& q, const Vector3<V>& L,
                                                 Vector3<V> I, double dt) {
  const auto sincos = [](const V& x, V& sine, V& cosine) {
    sincos_within_limit(x, sine, cosine);
    if (any((x > kSincosLimit<double>) | (x < -kSincosLimit<double>))) Sincos<V>{}(x, sine, cosine);
  };
  const Vector3<V> t = splat<V>(2) * cross(q.v, L);
  Vector3<V> m = L - q.w * t + cross(q.v, t);  // R^T L

  // Axes in the order of their moments.
  const auto first = I[0] > I[1];
  detail::exchange(first, I, 0, 1);
  detail::turn_frame(first, m, 0, 1);
  const auto second = I[1] > I[2];
  detail::exchange(second, I, 1, 2);
  detail::turn_frame(second, m, 1, 2);
  const auto third = I[0] > I[1];
  detail::exchange(third, I, 0, 1);
  detail::turn_frame(third, m, 0, 1);

  // About L: exp(dt L / I_2).
  const V common = 1.0 / I[1];
  const V rate = dt * common;
  const V angle = rate * square_root(dot(L, L));
  V s, c;
  sincos(0.5 * angle, s, c);
  const V over = select(angle * angle > 1e-8, s / angle, 0.5 - angle * angle / 48.0);
  const QuaternionLanes<V> about_L{c, over * rate * L};

  // About axis 1 by a half of the step, about axis 3, about axis 1; s and c of half the angles. Of
  // symmetric bodies one of the two is none.
  const V low = 0.25 * dt * (1.0 / I[0] - common), high = 0.5 * dt * (1.0 / I[2] - common);
  V sa{}, ca = splat<V>(1), sb{}, cb = splat<V>(1);
  if (any(low != 0.0)) sincos(low * m[0], sa, ca);
  V sg = sa, cg = ca;
  if (any(high != 0.0)) {
    const V C = 1.0 - 2.0 * sa * sa, S = 2.0 * sa * ca;
    const V m1 = C * m[1] + S * m[2];
    sincos(high * (C * m[2] - S * m[1]), sb, cb);
    const V m0 = (1.0 - 2.0 * sb * sb) * m[0] + 2.0 * sb * cb * m1;
    if (any(low != 0.0)) sincos(low * m0, sg, cg);
  }
  QuaternionLanes<V> own{
      cb * (ca * cg - sa * sg),
      {{cb * (sa * cg + ca * sg), sb * (ca * sg - sa * cg), sb * (ca * cg + sa * sg)}}};

  detail::turn_frame_back(third, own.v, 0, 1);
  detail::turn_frame_back(second, own.v, 1, 2);
  detail::turn_frame_back(first, own.v, 0, 1);
  const QuaternionLanes<V> r = about_L * (q * own);
  const V scale = 1.0 / square_root(r.w * r.w + dot(r.v, r.v));
  const auto still = (L[0] == 0.0) & (L[1] == 0.0) & (L[2] == 0.0);
  QuaternionLanes<V> next{select(still, q.w, scale * r.w), {}};
  for (int i = 0; i < 3; ++i) next.v[i] = select(still, q.v[i], scale * r.v[i]);
  return next;
}

}  // namespace substep::rigid
