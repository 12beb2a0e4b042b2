#include "substep/rigid/solver/contact_packet.h"

#include <algorithm>

#include "substep/core/roots.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/contact_lanes.h"

namespace substep::rigid {
namespace {

using V = ContactPacket::V;
using V3 = ContactPacket::V3;
using F = ContactPacket::F;
using F3 = ContactPacket::F3;

constexpr double kRegularisation = 0.02;  // eps
// Of an impact: the most sweeps over one contact, until friction changes by less of its bound.
constexpr int kImpactSweeps = 8;
constexpr double kConverged = 0.03;

// Where A_kl of a symmetric block is.
constexpr int at(int k, int l) { return k < l ? at(l, k) : k * (k + 1) / 2 + l; }

SUBSTEP_INLINE V max(const V& x, const V& y) { return x > y ? x : y; }
SUBSTEP_INLINE V min(const V& x, const V& y) { return x < y ? x : y; }
SUBSTEP_INLINE V inverse_of(const V& x) { return x > 0 ? 1 / x : V{}; }
SUBSTEP_INLINE void add(V3& x, const V& s, const V3& y) {
  for (int i = 0; i < 3; ++i) x[i] = fma(s, y[i], x[i]);
}
SUBSTEP_INLINE V3 opposite(const V3& x) { return {{-x[0], -x[1], -x[2]}}; }
// x, y, z along axes: components to a vector.
SUBSTEP_INLINE V3 combine(const V3& c, const V3& x, const V3& y, const V3& z) {
  V3 sum;
  for (int i = 0; i < 3; ++i) sum[i] = fma(c[0], x[i], fma(c[1], y[i], c[2] * z[i]));
  return sum;
}

// Eigenvalue of [xx xy; xy yy].
SUBSTEP_INLINE V largest_of(const V& xx, const V& xy, const V& yy) {
  const V half = 0.5 * (xx - yy), square = half * half + xy * xy;
  return 0.5 * (xx + yy) + square * inverse_sqrt(max(square, splat<V>(1e-300)));
}

// What the kernels leave out, as it would only add zeros: the a or the b of packets where all of
// them are the world, and points that no contact has.
template <bool kHasA, bool kHasB, int kMostPoints>
struct Form {
  static constexpr bool has_a = kHasA, has_b = kHasB;
  static constexpr int points = kMostPoints;
};
template <class Call>
SUBSTEP_INLINE void with_form(const ContactPacket& c, const Call& call) {
  const auto with = [&]<int points>() __attribute__((always_inline)) {
    if (!c.has_a) {
      call(Form<false, true, points>{});
    } else if (!c.has_b) {
      call(Form<true, false, points>{});
    } else {
      call(Form<true, true, points>{});
    }
  };
  if (c.few) {
    with.template operator()<2>();
  } else {
    with.template operator()<4>();
  }
}

// The bodies of a packet: velocities, or displacements.
struct Both {
  BodyLanes a, b;
};
template <class Form>
SUBSTEP_INLINE Both load_both(Form, const BodyRows::Rows& rows, const ContactPacket& c) {
  const BodyRow* first = rows.data();
  Both m{};
  if constexpr (Form::has_a) m.a = load_bodies([&](int lane) { return first + c.a[lane]; });
  if constexpr (Form::has_b) m.b = load_bodies([&](int lane) { return first + c.b[lane]; });
  return m;
}
// Rows of bodies that impulses do not move stay untouched: several packets may read them at once.
template <class Form>
SUBSTEP_INLINE void store_both(Form, const Both& m, BodyRows::Rows& rows, const ContactPacket& c,
                               const bool* to_a, const bool* to_b) {
  BodyRow nowhere[ContactPacket::kLanes];
  BodyRow* first = rows.data();
  if constexpr (Form::has_a)
    store_bodies(m.a, [&](int k) { return to_a[k] ? first + c.a[k] : nowhere + k; });
  if constexpr (Form::has_b)
    store_bodies(m.b, [&](int k) { return to_b[k] ? first + c.b[k] : nowhere + k; });
}
template <class Form>
SUBSTEP_INLINE void store_both(Form form, const Both& m, BodyRows::Rows& rows,
                               const ContactPacket& c) {
  store_both(form, m, rows, c, c.moves_a, c.moves_b);
}

// How b moves relative to a at the contact, in its axes; or a force and a torque there.
struct Twist {
  V3 linear, angular;
};

SUBSTEP_INLINE V3 turn(const F3 (&axis)[3], const V3& w) {
  return {{fused_dot(wide(axis[0]), w), fused_dot(wide(axis[1]), w), fused_dot(wide(axis[2]), w)}};
}
template <class Form>
SUBSTEP_INLINE Twist relative(Form, const ContactPacket& c, const Both& m) {
  V3 v, at, w;
  if constexpr (Form::has_a) {
    const V3 w_a = turn(c.axis_a, m.a.angular);
    v = opposite(c.scale_a * m.a.linear);
    at = opposite(fused_cross(w_a, wide(c.arm_a)));
    w = opposite(w_a);
  }
  if constexpr (Form::has_b) {
    const V3 w_b = turn(c.axis_b, m.b.angular), b = fused_cross(w_b, wide(c.arm_b));
    if constexpr (Form::has_a) {
      add(v, c.scale_b, m.b.linear);
      at = b + at, w = w_b + w;
    } else {
      v = c.scale_b * m.b.linear, at = b, w = w_b;
    }
  }
  const V3 second = fused_cross(c.normal, c.tangent);
  const V3 u{{fused_dot(c.tangent, v), fused_dot(second, v), fused_dot(c.normal, v)}};
  return {u + at, w};
}
template <class Form>
SUBSTEP_INLINE void apply(Form, const ContactPacket& c, const Twist& impulse, Both& m) {
  const V3 second = fused_cross(c.normal, c.tangent);
  const V3 force = combine(impulse.linear, c.tangent, second, c.normal);
  if constexpr (Form::has_a) {
    add(m.a.linear, -c.scale_a, force);
    const V3 torque = fused_cross(wide(c.arm_a), impulse.linear) + impulse.angular;
    for (int i = 0; i < 3; ++i) add(m.a.angular, -torque[i], wide(c.axis_a[i]));
  }
  if constexpr (Form::has_b) {
    add(m.b.linear, c.scale_b, force);
    const V3 torque = fused_cross(wide(c.arm_b), impulse.linear) + impulse.angular;
    for (int i = 0; i < 3; ++i) add(m.b.angular, torque[i], wide(c.axis_b[i]));
  }
}

// Force and torque of the normal impulses.
template <class Form>
SUBSTEP_INLINE void add_normal(Form, const ContactPacket& c, const V (&d)[4], Twist& impulse) {
  impulse.linear[2] = impulse.linear[2] + ((d[0] + d[1]) + (d[2] + d[3]));
  for (int k = 0; k < Form::points; ++k) {
    impulse.angular[0] = fma(wide(c.q[k]), d[k], impulse.angular[0]);
    impulse.angular[1] = fma(-wide(c.p[k]), d[k], impulse.angular[1]);
  }
}
template <class Form>
SUBSTEP_INLINE Twist impulse_of(Form form, const ContactPacket& c) {
  Twist l{{{c.slide_impulse[0], c.slide_impulse[1], V{}}}, {{V{}, V{}, c.twist_impulse}}};
  if (c.rolls) l.angular[0] = c.roll_impulse[0], l.angular[1] = c.roll_impulse[1];
  add_normal(form, c, c.impulse, l);
  return l;
}
// Normal velocities of the points.
template <class Form>
SUBSTEP_INLINE void approach(Form, const ContactPacket& c, const Twist& u, V (&result)[4]) {
  for (int k = 0; k < Form::points; ++k) {
    result[k] = fma(wide(c.q[k]), u.angular[0], fma(-wide(c.p[k]), u.angular[1], u.linear[2]));
  }
}

// The change d of impulses l >= 0, in units of 1 / mobility, that makes residual + block d as near
// 0 as they allow. Where not all points press: as far towards the unrestricted solution as all of
// them can go together, which keeps the symmetry of a box that lifts off, and from there sweeps.
// Each lowers the energy.
template <class Form>
SUBSTEP_INLINE void solve_block(Form, const ContactPacket& c, const V (&residual)[4],
                                const V (&l)[4], V (&d)[4]) {
  constexpr int n = Form::points;
  auto pulls = l[0] < l[0];
  V part = splat<V>(1);
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) {
    V sum = wide(c.inverse[at(k, 0)]) * residual[0];
#pragma GCC unroll 4
    for (int j = 1; j < n; ++j) sum = fma(wide(c.inverse[at(k, j)]), residual[j], sum);
    d[k] = -sum;
    pulls = pulls | (l[k] + d[k] < 0);
  }
  if (!any(pulls)) return;
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) {
    const auto negative = l[k] + d[k] < 0;
    part = negative ? min(part, l[k] / (negative ? -d[k] : splat<V>(1))) : part;
  }
  V e[4];
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) e[k] = part * d[k];
  const auto solve_point = [&](int k) __attribute__((always_inline)) {
    V r = residual[k];
#pragma GCC unroll 4
    for (int i = 0; i < n; ++i) r = fma(wide(c.block[at(k, i)]), e[i], r);
    e[k] = max(fma(-r, wide(c.diagonal[k]), l[k] + e[k]), V{}) - l[k];
  };
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) solve_point(k);
#pragma GCC unroll 4
  for (int k = n - 1; k >= 0; --k) solve_point(k);
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) d[k] = pulls ? e[k] : d[k];
}

// x, or what of it is within the disc.
SUBSTEP_INLINE void limit_to(const V& radius, V (&x)[2]) {
  const V square = x[0] * x[0] + x[1] * x[1];
  const auto beyond = square > radius * radius;
  const V factor = beyond ? radius * inverse_sqrt(beyond ? square : splat<V>(1)) : splat<V>(1);
  for (int i = 0; i < 2; ++i) x[i] = x[i] * factor;
}

// Adds to the impulse, and to u what the normal impulses see of it. Friction cannot be projected
// onto the disc along A^-1, which would turn it: where it slides the scalar step with the largest
// mobility has its fixed point where l_t is opposite to u_t.
template <class Form>
SUBSTEP_INLINE void solve_friction(Form, ContactPacket& c, Twist& u, Twist& impulse) {
  const V inverse = inverse_of(c.mobility), friction = wide(c.friction), press = c.pressure();
  V lever = wide(c.spinning) * press;
  for (int k = 0; k < Form::points; ++k)
    lever = fma(friction * wide(c.lever[k]), c.impulse[k], lever);
  const V step = -u.angular[2] * (wide(c.twist_inverse) * inverse);
  const V twist = max(-lever, min(lever, c.twist_impulse + step));
  V stick[2], slide[2];
  const V x = u.linear[0] * inverse, y = u.linear[1] * inverse;
  stick[0] = c.slide_impulse[0] - fma(wide(c.slide_inverse[0]), x, wide(c.slide_inverse[1]) * y);
  stick[1] = c.slide_impulse[1] - fma(wide(c.slide_inverse[1]), x, wide(c.slide_inverse[2]) * y);
  const V limit = friction * press;
  const auto slides = stick[0] * stick[0] + stick[1] * stick[1] > limit * limit;
  if (any(slides)) {
    slide[0] = fma(-x, wide(c.slide_bound), c.slide_impulse[0]);
    slide[1] = fma(-y, wide(c.slide_bound), c.slide_impulse[1]);
    limit_to(limit, slide);
    for (int i = 0; i < 2; ++i) stick[i] = slides ? slide[i] : stick[i];
  }
  const V d[3] = {stick[0] - c.slide_impulse[0], stick[1] - c.slide_impulse[1],
                  twist - c.twist_impulse};
  c.slide_impulse[0] = stick[0], c.slide_impulse[1] = stick[1], c.twist_impulse = twist;
  impulse.linear[0] = d[0], impulse.linear[1] = d[1], impulse.angular[2] = d[2];
  const V e[3] = {d[0] * c.mobility, d[1] * c.mobility, d[2] * c.mobility};
  V change[3];
  for (int i = 0; i < 3; ++i) {
    change[i] = fma(wide(c.coupling[i][0]), e[0],
                    fma(wide(c.coupling[i][1]), e[1], wide(c.coupling[i][2]) * e[2]));
  }
  u.linear[2] = u.linear[2] + change[0];
  for (int i = 0; i < 2; ++i) u.angular[i] = u.angular[i] + change[i + 1];
}

// The step with the largest mobility, projected onto the disc; u is that before the normal
// impulses.
SUBSTEP_INLINE void solve_rolling(ContactPacket& c, const Twist& u, Twist& impulse) {
  const V inverse = inverse_of(c.mobility);
  const auto& M = c.roll_mobility;  // from (t_1, t_1), (t_1, t_2), (t_2, t_2), l_n to both
  const V &f = impulse.linear[2], &s = impulse.angular[0], &t = impulse.angular[1];
  const V change[2] = {fma(wide(M[3]), f, fma(wide(M[0]), s, wide(M[1]) * t)),
                       fma(wide(M[4]), f, fma(wide(M[1]), s, wide(M[2]) * t))};
  V l[2];
  for (int i = 0; i < 2; ++i) {
    const V w = fma(u.angular[i], inverse, change[i]);
    l[i] = fma(-w, wide(c.roll_inverse), c.roll_impulse[i]);
  }
  limit_to(wide(c.rolling) * c.pressure(), l);
  for (int i = 0; i < 2; ++i) {
    impulse.angular[i] = impulse.angular[i] + (l[i] - c.roll_impulse[i]);
    c.roll_impulse[i] = l[i];
  }
}

// M, a symmetric 6 x 6 matrix, of both bodies: from forces (0, 1, 2) and torques (3, 4, 5) along
// the axes to linear and angular velocities. With N of torques, s^2 of forces through the centre
// and [r] x = r x x it is [s^2 + [r]^T N [r], (N [r])^T; N [r], N].
struct Mobility {
  V linear[6], mixed[3][3], angular[6];

  SUBSTEP_INLINE const V& operator()(int i, int j) const {
    if (i < 3 && j < 3) return linear[at(i, j)];
    if (i >= 3 && j >= 3) return angular[at(i - 3, j - 3)];
    return i < 3 ? mixed[j - 3][i] : mixed[i - 3][j];
  }
  SUBSTEP_INLINE void add(const RootLanes& root, const V3 (&axis)[3], const V3& r) {
    V N[6], K[3][3];
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
      for (int j = 0; j <= i; ++j) N[at(i, j)] = root.moves * fused_dot(axis[i], axis[j]);
    }
    const auto less = [](const V& a, const V& b, const V& c, const V& d)
                          __attribute__((always_inline)) { return fma(a, b, -(c * d)); };
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
      K[i][0] = less(N[at(i, 1)], r[2], N[at(i, 2)], r[1]);
      K[i][1] = less(N[at(i, 2)], r[0], N[at(i, 0)], r[2]);
      K[i][2] = less(N[at(i, 0)], r[1], N[at(i, 1)], r[0]);
    }
    const V through = root.moves * root.scale * root.scale;
    linear[0] = linear[0] + (less(r[2], K[1][0], r[1], K[2][0]) + through);
    linear[1] = linear[1] + less(r[2], K[1][1], r[1], K[2][1]);
    linear[2] = linear[2] + (less(r[0], K[2][1], r[2], K[0][1]) + through);
    linear[3] = linear[3] + less(r[2], K[1][2], r[1], K[2][2]);
    linear[4] = linear[4] + less(r[0], K[2][2], r[2], K[0][2]);
    linear[5] = linear[5] + (less(r[1], K[0][2], r[0], K[1][2]) + through);
#pragma GCC unroll 6
    for (int k = 0; k < 6; ++k) angular[k] = angular[k] + N[k];
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) {
#pragma GCC unroll 3
      for (int j = 0; j < 3; ++j) mixed[i][j] = mixed[i][j] + K[i][j];
    }
  }
};

// The inverse of a symmetric positive 4 x 4 matrix by blocks of 2 x 2: with [A B; B^T D],
// X = A^-1 B and S = D - B^T X it is [A^-1 + X S^-1 X^T, -X S^-1; ., S^-1].
SUBSTEP_INLINE void invert(const V (&m)[10], V (&inverse)[10]) {
  struct Pair {
    V x, y, z;  // [x y; y z]
  };
  const auto inverted = [](const Pair& p) __attribute__((always_inline)) {
    const V scale = 1 / (p.x * p.z - p.y * p.y);
    return Pair{scale * p.z, -scale * p.y, scale * p.x};
  };
  const Pair A = inverted({m[0], m[1], m[2]});
  const V b[2][2] = {{m[at(2, 0)], m[at(3, 0)]}, {m[at(2, 1)], m[at(3, 1)]}};
  V x[2][2], y[2][2];
  for (int j = 0; j < 2; ++j) {
    x[0][j] = A.x * b[0][j] + A.y * b[1][j];
    x[1][j] = A.y * b[0][j] + A.z * b[1][j];
  }
  const auto column = [&](int i, int j) __attribute__((always_inline)) {
    return b[0][i] * x[0][j] + b[1][i] * x[1][j];
  };
  const Pair S = inverted(
      {m[at(2, 2)] - column(0, 0), m[at(3, 2)] - column(0, 1), m[at(3, 3)] - column(1, 1)});
  for (int i = 0; i < 2; ++i) {
    y[i][0] = x[i][0] * S.x + x[i][1] * S.y;
    y[i][1] = x[i][0] * S.y + x[i][1] * S.z;
  }
  inverse[at(0, 0)] = A.x + (y[0][0] * x[0][0] + y[0][1] * x[0][1]);
  inverse[at(1, 0)] = A.y + (y[0][0] * x[1][0] + y[0][1] * x[1][1]);
  inverse[at(1, 1)] = A.z + (y[1][0] * x[1][0] + y[1][1] * x[1][1]);
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) inverse[at(2 + j, i)] = -y[i][j];
  }
  inverse[at(2, 2)] = S.x, inverse[at(3, 2)] = S.y, inverse[at(3, 3)] = S.z;
}

// A + eps of the first n points, what is made of it, and identities for the others.
template <int n>
SUBSTEP_INLINE void find_block(ContactPacket& c, const Mobility& M) {
  V A[10] = {}, regular[10] = {};
  V largest{};
#pragma GCC unroll 4
  for (int k = 0; k < n; ++k) {
    const V pk = wide(c.p[k]), qk = wide(c.q[k]);
    const V column[3] = {fma(qk, M(2, 3), fma(-pk, M(2, 4), M(2, 2))),
                         fma(qk, M(3, 3), fma(-pk, M(3, 4), M(3, 2))),
                         fma(qk, M(4, 3), fma(-pk, M(4, 4), M(4, 2)))};
#pragma GCC unroll 4
    for (int l = 0; l <= k; ++l) {
      A[at(k, l)] = wide(c.used[k]) * wide(c.used[l]) *
                    fma(wide(c.q[l]), column[1], fma(-wide(c.p[l]), column[2], column[0]));
    }
    largest = max(largest, A[at(k, k)]);
  }
  c.mobility = largest;
  const V unit = inverse_of(largest);
#pragma GCC unroll 4
  for (int k = 0; k < 4; ++k) {
#pragma GCC unroll 4
    for (int l = 0; l < k; ++l) A[at(k, l)] = A[at(k, l)] * unit;
    const auto is = wide(c.used[k]) > 0;
    V& entry = A[at(k, k)];
    entry = is ? fma(entry, unit, kRegularisation) : splat<V>(1);
    c.diagonal[k] = k < n ? narrow(is ? 1 / entry : V{}) : F{};
  }
  if constexpr (n == 2) {
    const V scale = 1 / (A[0] * A[2] - A[1] * A[1]);
    regular[0] = scale * A[2], regular[1] = -scale * A[1], regular[2] = scale * A[0];
    regular[at(2, 2)] = regular[at(3, 3)] = splat<V>(1);
  } else {
    invert(A, regular);
  }
#pragma GCC unroll 10
  for (int k = 0; k < 10; ++k) c.block[k] = narrow(A[k]), c.inverse[k] = narrow(regular[k]);
#pragma GCC unroll 4
  for (int k = 0; k < 4; ++k) c.inverse[at(k, k)] = c.used[k] * c.inverse[at(k, k)];
}

}  // namespace

void ContactPacket::set(const ContactConstraint* const (&contacts)[kLanes],
                        const bool (&lanes)[kLanes], const BodyRows& rows) {
  static const ContactConstraint kNone{};
  V3 arms_a[4] = {}, arms_b[4] = {};
  V count{}, chosen{};  // chosen: 1 where a lane is set
  for (int lane = 0; lane < kLanes; ++lane) {
    if (!lanes[lane]) continue;
    const ContactConstraint& c = contacts[lane] != nullptr ? *contacts[lane] : kNone;
    a[lane] = contacts[lane] != nullptr ? rows.row(c.a) : 0;
    b[lane] = contacts[lane] != nullptr ? rows.row(c.b) : 0;
    moves_a[lane] = rows.moves(a[lane]), moves_b[lane] = rows.moves(b[lane]);
    for (int i = 0; i < 3; ++i) {
      normal[i][lane] = c.normal[i], tangent[i][lane] = c.tangent[i], bias[i][lane] = 0;
    }
    count[lane] = c.count, chosen[lane] = 1;
    for (int k = 0; k < 4; ++k) {
      const bool is = k < c.count;
      used[k][lane] = is ? 1 : 0;
      separation[k][lane] = is ? static_cast<float>(c.points[k].separation) : kFarAway;
      impulse[k][lane] = is ? c.points[k].impulse : 0;
      if (!is) continue;
      for (int i = 0; i < 3; ++i) {
        arms_a[k][i][lane] = c.points[k].arm_a[i];
        arms_b[k][i][lane] = c.points[k].arm_b[i];
      }
    }
    friction[lane] = static_cast<float>(c.mu()), spinning[lane] = static_cast<float>(c.spinning);
    away[lane] = 0;
    slide_impulse[0][lane] = c.friction_impulse[0], slide_impulse[1][lane] = c.friction_impulse[1];
    twist_impulse[lane] = c.twist_impulse;
    rolling[lane] = static_cast<float>(c.rolling);
    for (int i = 0; i < 2; ++i) roll_impulse[i][lane] = c.roll_impulse[i];
  }
  rolls_on = false;
  const V3 second = cross(normal, tangent);
  const auto along_axes = [&](const V3& r) {
    return V3{{dot(r, tangent), dot(r, second), dot(r, normal)}};
  };
  const auto middle = [&](const V3(&arms)[4]) {
    V3 sum = ((arms[0] + arms[1]) + arms[2]) + arms[3];
    for (int i = 0; i < 3; ++i) sum[i] = sum[i] / (count > 0 ? count : splat<V>(1));
    return along_axes(sum);
  };
  const auto keep = [is_set = narrow(chosen) > 0](F& old, const V& value) {
    old = is_set ? narrow(value) : old;
  };
  const V3 middle_a = middle(arms_a), middle_b = middle(arms_b);
  for (int i = 0; i < 3; ++i) keep(arm_a[i], middle_a[i]), keep(arm_b[i], middle_b[i]);
  for (int k = 0; k < 4; ++k) {
    const V3 r = along_axes(arms_a[k]);
    const auto is = count > k;
    const V x = is ? r[0] - middle_a[0] : V{}, y = is ? r[1] - middle_a[1] : V{};
    keep(p[k], x), keep(q[k], y), keep(lever[k], sqrt(x * x + y * y));
  }
}

void ContactPacket::get(int lane, ContactConstraint& contact) const {
  for (int k = 0; k < contact.count; ++k) contact.points[k].impulse = impulse[k][lane];
  contact.friction_impulse[0] = slide_impulse[0][lane];
  contact.friction_impulse[1] = slide_impulse[1][lane];
  contact.twist_impulse = twist_impulse[lane];
  for (int i = 0; i < 2; ++i) contact.roll_impulse[i] = rolls ? roll_impulse[i][lane] : 0;
}

void ContactPacket::prepare(const BodyRows& rows) {
  const auto any_row = [](const std::int32_t (&rows_of)[kLanes]) {
    return std::any_of(rows_of, rows_of + kLanes, [](std::int32_t row) { return row > 0; });
  };
  has_a = any_row(a), has_b = any_row(b);
  kinematic = false;
  for (int lane = 0; lane < kLanes; ++lane)
    kinematic |= (a[lane] > 0 && !moves_a[lane]) || (b[lane] > 0 && !moves_b[lane]);
  few = !any(wide(used[2]) > 0);
  rolls = any(wide(rolling) > 0);
  const V3 axes[3] = {tangent, fused_cross(normal, tangent), normal};
  Mobility M{};
  const auto add_body = [&](bool any_body, const std::int32_t* index, V& scale, F3(&axis)[3],
                            const F3& arm) {
    scale = V{};
    for (F3& one : axis) one = F3{};
    if (!any_body) return;
    const RootLanes root(rows, index);
    scale = root.scale;
    V3 turned[3];
    for (int i = 0; i < 3; ++i) {
      turned[i] = root * axes[i];
      axis[i] = narrow(turned[i]);
    }
    M.add(root, turned, wide(arm));
  };
  add_body(has_a, a, scale_a, axis_a, arm_a);
  add_body(has_b, b, scale_b, axis_b, arm_b);

  if (few) {
    find_block<2>(*this, M);
  } else {
    find_block<4>(*this, M);
  }
  const V unit = inverse_of(mobility);
  const auto of = [&](int i, int j) __attribute__((always_inline)) { return M(i, j) * unit; };
  const V xx = of(0, 0), xy = of(0, 1), yy = of(1, 1), scale = inverse_of(xx * yy - xy * xy);
  slide_inverse[0] = narrow(scale * yy);
  slide_inverse[1] = narrow(-scale * xy);
  slide_inverse[2] = narrow(scale * xx);
  slide_bound = narrow(inverse_of(largest_of(xx, xy, yy)));
  twist_inverse = narrow(inverse_of(of(5, 5)));
  constexpr int kFrom[3] = {0, 1, 5};
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) coupling[i][j] = narrow(of(2 + i, kFrom[j]));
  }
  if (!rolls) return;
  roll_inverse = narrow(inverse_of(largest_of(of(3, 3), of(3, 4), of(4, 4))));
  constexpr int kRolls[5][2] = {{3, 3}, {3, 4}, {4, 4}, {3, 2}, {4, 2}};
  for (int k = 0; k < 5; ++k) roll_mobility[k] = narrow(of(kRolls[k][0], kRolls[k][1]));
}

void ContactPacket::push(const V& part, BodyRows::Rows& rows, const bool* to_a,
                         const bool* to_b) const {
  with_form(*this, [&](auto form) __attribute__((always_inline)) {
    Both m = load_both(form, rows, *this);
    const Twist l = impulse_of(form, *this);
    apply(form, *this, {part * l.linear, part * l.angular}, m);
    store_both(form, m, rows, *this, to_a, to_b);
  });
}

BodyRow ContactPacket::impulse_on(int lane, bool on_b) const {
  const auto at = [lane](const auto& v) { return Vec3(v[0][lane], v[1][lane], v[2][lane]); };
  const Vec3 l(slide_impulse[0][lane], slide_impulse[1][lane], pressure()[lane]);
  Vec3 torque(rolls ? roll_impulse[0][lane] : 0, rolls ? roll_impulse[1][lane] : 0,
              twist_impulse[lane]);
  for (int k = 0; k < 4; ++k) {
    torque[0] += q[k][lane] * impulse[k][lane];
    torque[1] -= p[k][lane] * impulse[k][lane];
  }
  torque += at(on_b ? arm_b : arm_a).cross(l);
  const auto& axis = on_b ? axis_b : axis_a;
  const Vec3 t = at(tangent), n = at(normal);
  const double sign = on_b ? 1 : -1, scale = sign * (on_b ? scale_b : scale_a)[lane];
  const Vec3 linear = scale * (t * l[0] + n.cross(t) * l[1] + n * l[2]);
  const Vec3 angular =
      sign * (torque[0] * at(axis[0]) + torque[1] * at(axis[1]) + torque[2] * at(axis[2]));
  return {{linear[0], linear[1], linear[2], 0}, {angular[0], angular[1], angular[2], 0}};
}

V ContactPacket::braking(const BodyRows& rows) const {
  V power{};
  with_form(*this, [&](auto form) __attribute__((always_inline)) {
    const Twist u = relative(form, *this, load_both(form, rows.velocity, *this));
    power = fma(slide_impulse[0], u.linear[0],
                fma(slide_impulse[1], u.linear[1], twist_impulse * u.angular[2]));
  });
  return min(power, V{});
}

V ContactPacket::power_of_unmoved(const BodyRows& rows) const {
  constexpr Form<true, true, 4> form;
  Both m = load_both(form, rows.velocity, *this);
  V still_a, still_b;
  for (int k = 0; k < kLanes; ++k) still_a[k] = moves_a[k] ? 0 : 1, still_b[k] = moves_b[k] ? 0 : 1;
  m.a.linear = still_a * m.a.linear, m.a.angular = still_a * m.a.angular;
  m.b.linear = still_b * m.b.linear, m.b.angular = still_b * m.b.angular;
  const Twist u = relative(form, *this, m), l = impulse_of(form, *this);
  return fused_dot(u.linear, l.linear) + fused_dot(u.angular, l.angular);
}

void ContactPacket::scale_impulses(const V& part) {
  for (auto& l : impulse) l = part * l;
  for (auto& l : slide_impulse) l = part * l;
  for (auto& l : roll_impulse) l = part * l;
  twist_impulse = part * twist_impulse;
}

void ContactPacket::scale_impulses(int lane, double part) {
  V parts = splat<V>(1);
  parts[lane] = part;
  scale_impulses(parts);
}

void ContactPacket::withdraw_push(BodyRows& rows) const {
  bool to_a[kLanes], to_b[kLanes];  // what turns has no push left
  for (int lane = 0; lane < kLanes; ++lane) {
    to_a[lane] = moves_a[lane] && rows.turns[usize(a[lane])] == 0;
    to_b[lane] = moves_b[lane] && rows.turns[usize(b[lane])] == 0;
  }
  push(splat<V>(-1), rows.push, to_a, to_b);
}

bool ContactPacket::is_uneven(double ratio) const {
  const V a_squared = scale_a * scale_a, b_squared = scale_b * scale_b;  // 1 / m
  return any((a_squared > 0) & (b_squared > 0) &
             ((a_squared > ratio * b_squared) | (b_squared > ratio * a_squared)));
}

void ContactPacket::find_separations(const BodyRows& rows, V (&C)[4]) const {
  constexpr Form<true, true, 4> form;
  approach(form, *this, relative(form, *this, load_both(form, rows.displacement, *this)), C);
  for (int k = 0; k < 4; ++k) C[k] = C[k] + wide(separation[k]);
}

void ContactPacket::rebase(const BodyRows& rows, const bool (&lanes)[kLanes]) {
  V moved[4];
  constexpr Form<true, true, 4> form;
  approach(form, *this, relative(form, *this, load_both(form, rows.displacement, *this)), moved);
  for (int k = 0; k < 4; ++k) {
    for (int lane = 0; lane < kLanes; ++lane)
      if (lanes[lane]) separation[k][lane] -= static_cast<float>(moved[k][lane]);
  }
}

// Bearing bodies are the world.
ContactPacket ContactPacket::on_fixed_bearers(const BodyRows& rows) const {
  ContactPacket fixed = *this;
  for (int lane = 0; lane < kLanes; ++lane) {
    if ((bears_a >> lane & 1) != 0) fixed.a[lane] = 0;
    if ((bears_b >> lane & 1) != 0) fixed.b[lane] = 0;
  }
  fixed.prepare(rows);
  return fixed;
}

template <class Form>
SUBSTEP_INLINE void ContactPacket::solve_positions_of(Form form, BodyRows& rows,
                                                      const Settings& settings) {
  Both m = load_both(form, rows.displacement, *this);
  V C[4];
  approach(form, *this, relative(form, *this, m), C);
  auto deep = C[0] < C[0];
  for (int k = 0; k < Form::points; ++k) {
    C[k] = C[k] + wide(separation[k] + away);
    target[k] = narrow(max(C[k], V{}) * settings.inverse_h);
    const V overlap = C[k] + settings.slop;
    const auto is = overlap < 0;
    deep = deep | is;
    C[k] = is ? max(settings.correction * overlap, splat<V>(-settings.push)) : overlap;
  }
  if (!any(deep)) return;
  const auto move_apart = [&](const ContactPacket& c) __attribute__((always_inline)) {
    const V unit = inverse_of(c.mobility);
    V d[4] = {};
    const V none[4] = {};
    for (int k = 0; k < Form::points; ++k) C[k] = unit * C[k];
    solve_block(form, c, C, none, d);
    Twist l{};
    add_normal(form, c, d, l);
    apply(form, c, l, m);
  };
  if ((bears_a | bears_b) != 0) {
    move_apart(on_fixed_bearers(rows));
  } else {
    move_apart(*this);
  }
  store_both(form, m, rows.displacement, *this);
}

void ContactPacket::solve_positions(BodyRows& rows, const Settings& settings) {
  with_form(*this, [&](auto form) { solve_positions_of(form, rows, settings); });
}

template <class Form>
SUBSTEP_INLINE void sweep_velocities(Form form, ContactPacket& c, Both& m) {
  Twist u = relative(form, c, m), l{};
  if (c.rolls_on)
    for (int i = 0; i < 3; ++i) u.linear[i] = u.linear[i] + wide(c.bias[i]);
  solve_friction(form, c, u, l);
  V residual[4], d[4] = {};
  approach(form, c, u, residual);
  const V unit = inverse_of(c.mobility);
  for (int k = 0; k < Form::points; ++k) residual[k] = (residual[k] + wide(c.target[k])) * unit;
  solve_block(form, c, residual, c.impulse, d);
  for (int k = 0; k < Form::points; ++k) c.impulse[k] = c.impulse[k] + d[k];
  add_normal(form, c, d, l);
  if (c.rolls) solve_rolling(c, u, l);
  apply(form, c, l, m);
}

void ContactPacket::solve_velocities(BodyRows& rows) {
  with_form(*this, [&](auto form) {
    Both m = load_both(form, rows.velocity, *this);
    sweep_velocities(form, *this, m);
    store_both(form, m, rows.velocity, *this);
  });
}

// The bodies stay in registers. Impulses do not change the world, but what is kinematic they do.
void ContactPacket::solve_impact(BodyRows& rows) {
  with_form(*this, [&](auto form) {
    Both m = load_both(form, rows.velocity, *this);
    for (int sweep = 0; sweep < kImpactSweeps; ++sweep) {
      const V before[2] = {slide_impulse[0], slide_impulse[1]};
      sweep_velocities(form, *this, m);
      if (kinematic) {
        store_both(form, m, rows.velocity, *this);
        m = load_both(form, rows.velocity, *this);
      }
      const V x = slide_impulse[0] - before[0], y = slide_impulse[1] - before[1];
      const V bound = kConverged * wide(friction) * pressure();
      if (!any(x * x + y * y > bound * bound)) break;
    }
    store_both(form, m, rows.velocity, *this);
  });
}

}  // namespace substep::rigid
