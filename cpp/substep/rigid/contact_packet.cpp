#include "substep/rigid/contact_packet.h"

#include "substep/core/point_lanes.h"
#include "substep/core/point_scatter.h"

namespace substep::rigid {
namespace {

using V = ContactPacket::V;
using V3 = ContactPacket::V3;
constexpr int kLanes = ContactPacket::kLanes;

constexpr double kRegularisation = 0.02;  // eps
constexpr int kBlockSweeps = 2;           // where not all points press

// Where A_kl of a symmetric block is.
constexpr int at(int k, int l) { return k < l ? at(l, k) : k * (k + 1) / 2 + l; }

SUBSTEP_INLINE V max(const V& x, const V& y) { return x > y ? x : y; }
SUBSTEP_INLINE V min(const V& x, const V& y) { return x < y ? x : y; }
SUBSTEP_INLINE V fused_dot(const V3& x, const V3& y) {
  return fma(x[0], y[0], fma(x[1], y[1], x[2] * y[2]));
}
SUBSTEP_INLINE void add(V3& x, const V& s, const V3& y) {
  for (int i = 0; i < 3; ++i) x[i] = fma(s, y[i], x[i]);
}
// sqrt(a) for a >= 0, one instruction.
SUBSTEP_INLINE V root_of(const V& a) {
  const V positive = max(a, splat<V>(1e-300));
  return positive * inverse_sqrt(positive);
}

// Eigenvalue of [xx xy; xy yy].
SUBSTEP_INLINE V largest_of(const V& xx, const V& xy, const V& yy) {
  const V half = 0.5 * (xx - yy);
  return 0.5 * (xx + yy) + root_of(half * half + xy * xy);
}

// What a constraint sees of both bodies: velocities, or displacements.
struct Motion6 {
  V3 linear_a, angular_a, linear_b, angular_b;
};

SUBSTEP_INLINE void load_row(const BodyRow* rows, const std::int32_t* index, V3& linear,
                             V3& angular) {
  const auto p = load_rows<V>([&](int lane) { return &rows[index[lane]].linear; });
  const auto q = load_rows<V>([&](int lane) { return &rows[index[lane]].angular; });
  linear = {{p.x, p.y, p.z}}, angular = {{q.x, q.y, q.z}};
}
SUBSTEP_INLINE Motion6 load_motion(const BodyRows::Rows& rows, const ContactPacket& c) {
  Motion6 m;
  load_row(rows.data(), c.a, m.linear_a, m.angular_a);
  load_row(rows.data(), c.b, m.linear_b, m.angular_b);
  return m;
}
// Rows of bodies that impulses do not move stay untouched: several packets may read them at once.
SUBSTEP_INLINE void store_row(const V3& linear, const V3& angular, BodyRow* rows,
                              const std::int32_t* index, const bool* moves) {
  BodyRow nowhere[kLanes];
  const auto row = [&](int lane) { return moves[lane] ? rows + index[lane] : nowhere + lane; };
  store_rows<V>({linear[0], linear[1], linear[2], V{}}, [&](int k) { return &row(k)->linear; });
  store_rows<V>({angular[0], angular[1], angular[2], V{}}, [&](int k) { return &row(k)->angular; });
}
SUBSTEP_INLINE void store_motion(const Motion6& m, BodyRows::Rows& rows, const ContactPacket& c) {
  store_row(m.linear_a, m.angular_a, rows.data(), c.a, c.moves_a);
  store_row(m.linear_b, m.angular_b, rows.data(), c.b, c.moves_b);
}

// (j_0 . m, ..., j_3 . m)
SUBSTEP_INLINE void approach(const ContactPacket& c, const Motion6& m, V (&u)[4]) {
  const V linear = fma(c.scale_b, fused_dot(c.normal, m.linear_b),
                       -(c.scale_a * fused_dot(c.normal, m.linear_a)));
  for (int k = 0; k < 4; ++k) {
    u[k] = linear + (fused_dot(c.arm_b[k], m.angular_b) - fused_dot(c.arm_a[k], m.angular_a));
  }
}
SUBSTEP_INLINE void apply_normal(const ContactPacket& c, const V (&d)[4], Motion6& m) {
  const V sum = (d[0] + d[1]) + (d[2] + d[3]);
  add(m.linear_a, -(c.scale_a * sum), c.normal);
  add(m.linear_b, c.scale_b * sum, c.normal);
  for (int k = 0; k < 4; ++k) {
    add(m.angular_a, -d[k], c.arm_a[k]);
    add(m.angular_b, d[k], c.arm_b[k]);
  }
}
SUBSTEP_INLINE void apply_friction(const ContactPacket& c, const V (&d)[2], const V& twist,
                                   Motion6& m) {
  for (int i = 0; i < 2; ++i) {
    add(m.linear_a, -(c.scale_a * d[i]), c.tangent[i]);
    add(m.linear_b, c.scale_b * d[i], c.tangent[i]);
    add(m.angular_a, -d[i], c.slide_a[i]);
    add(m.angular_b, d[i], c.slide_b[i]);
  }
  add(m.angular_a, -twist, c.twist_a);
  add(m.angular_b, twist, c.twist_b);
}

// The change d of impulses l >= 0 that makes residual + block d as near 0 as they allow. Where not
// all points press: as far towards the unrestricted solution as all of them can go together, which
// keeps the symmetry of a box that lifts off, and from there sweeps. Each lowers the energy.
SUBSTEP_INLINE void solve_block(const ContactPacket& c, const V (&residual)[4], const V (&l)[4],
                                V (&d)[4]) {
  auto pulls = l[0] < l[0];
  V part = splat<V>(1);
  for (int k = 0; k < 4; ++k) {
    V sum = c.inverse[at(k, 0)] * residual[0];
    for (int j = 1; j < 4; ++j) sum = fma(c.inverse[at(k, j)], residual[j], sum);
    d[k] = -sum;
    const auto negative = l[k] + d[k] < 0;
    part = negative ? min(part, l[k] / (negative ? sum : splat<V>(1))) : part;
    pulls = pulls | negative;
  }
  if (!any(pulls)) return;
  V e[4];
  for (int k = 0; k < 4; ++k) e[k] = part * d[k];
  for (int sweep = 0; sweep < kBlockSweeps; ++sweep) {
    for (int q = 0; q < 4; ++q) {
      const int k = sweep % 2 == 0 ? q : 3 - q;
      V r = residual[k];
      for (int j = 0; j < 4; ++j) r = fma(c.block[at(k, j)], e[j], r);
      e[k] = max(fma(-r, c.diagonal[k], l[k] + e[k]), V{}) - l[k];
    }
  }
  for (int k = 0; k < 4; ++k) d[k] = pulls ? e[k] : d[k];
}

// Friction cannot be projected onto the disc along A^-1, which would turn it: where it slides the
// scalar step with the largest mobility has its fixed point where l_t is opposite to u_t.
SUBSTEP_INLINE void solve_friction(ContactPacket& c, Motion6& m) {
  const V pressure = (c.impulse[0] + c.impulse[1]) + (c.impulse[2] + c.impulse[3]);
  V lever = c.spinning * pressure;
  for (int k = 0; k < 4; ++k) lever = fma(c.friction * c.lever[k], c.impulse[k], lever);
  const V spin = fused_dot(c.twist_b, m.angular_b) - fused_dot(c.twist_a, m.angular_a);
  const V twist = max(-lever, min(lever, fma(-spin, c.twist_inverse, c.twist_impulse)));
  V u[2], stick[2], slide[2], d[2];
  for (int i = 0; i < 2; ++i) {
    u[i] = fma(c.scale_b, fused_dot(c.tangent[i], m.linear_b),
               -(c.scale_a * fused_dot(c.tangent[i], m.linear_a))) +
           (fused_dot(c.slide_b[i], m.angular_b) - fused_dot(c.slide_a[i], m.angular_a));
  }
  for (int i = 0; i < 2; ++i) {
    stick[i] = c.slide_impulse[i] - (c.slide_inverse[i] * u[0] + c.slide_inverse[i + 1] * u[1]);
    slide[i] = c.slide_impulse[i] - u[i] * c.slide_bound;
  }
  const V limit = c.friction * pressure;
  const auto sticks = stick[0] * stick[0] + stick[1] * stick[1] <= limit * limit;
  const V length = root_of(slide[0] * slide[0] + slide[1] * slide[1]);
  const V factor = length > limit ? limit / length : splat<V>(1);
  for (int i = 0; i < 2; ++i) {
    const V l = sticks ? stick[i] : slide[i] * factor;
    d[i] = l - c.slide_impulse[i];
    c.slide_impulse[i] = l;
  }
  apply_friction(c, d, twist - c.twist_impulse, m);
  c.twist_impulse = twist;
}

SUBSTEP_INLINE void apply_rolling(const ContactPacket& c, const V (&d)[2], Motion6& m) {
  for (int i = 0; i < 2; ++i) {
    add(m.angular_a, -d[i], c.roll_a[i]);
    add(m.angular_b, d[i], c.roll_b[i]);
  }
}

// The step with the largest mobility, projected onto the disc.
SUBSTEP_INLINE void solve_rolling(ContactPacket& c, Motion6& m) {
  const V limit = c.rolling * ((c.impulse[0] + c.impulse[1]) + (c.impulse[2] + c.impulse[3]));
  V l[2], d[2];
  for (int i = 0; i < 2; ++i) {
    const V w = fused_dot(c.roll_b[i], m.angular_b) - fused_dot(c.roll_a[i], m.angular_a);
    l[i] = fma(-w, c.roll_inverse, c.roll_impulse[i]);
  }
  const V length = root_of(l[0] * l[0] + l[1] * l[1]);
  const V factor = length > limit ? limit / length : splat<V>(1);
  for (int i = 0; i < 2; ++i) {
    d[i] = l[i] * factor - c.roll_impulse[i];
    c.roll_impulse[i] = l[i] * factor;
  }
  apply_rolling(c, d, m);
}

// W^(1/2) v
struct Root {
  V xx, yy, zz, xy, xz, yz, scale, moves;

  SUBSTEP_INLINE Root(const BodyRows& rows, const std::int32_t* index) {
    const auto d = load_rows<V>([&](int lane) { return &rows.root.data()[index[lane]].linear; });
    const auto m = load_rows<V>([&](int lane) { return &rows.root.data()[index[lane]].angular; });
    xx = d.x, yy = d.y, zz = d.z, scale = d.w;
    xy = m.x, xz = m.y, yz = m.z, moves = m.w;
  }
  SUBSTEP_INLINE V3 operator*(const V3& v) const {
    return {
        {fused_dot({{xx, xy, xz}}, v), fused_dot({{xy, yy, yz}}, v), fused_dot({{xz, yz, zz}}, v)}};
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

void set3(V3& v, int lane, const Vec3& value) {
  for (int i = 0; i < 3; ++i) v[i][lane] = value[i];
}

}  // namespace

void ContactPacket::set(int lane, const ContactConstraint* contact, const BodyRows& rows) {
  static const ContactConstraint kNone{};
  const ContactConstraint& c = contact != nullptr ? *contact : kNone;
  const Vec3 middle_a = c.middle(&ContactConstraint::Point::arm_a),
             middle_b = c.middle(&ContactConstraint::Point::arm_b);
  a[lane] = contact != nullptr ? rows.row(c.a) : 0;
  b[lane] = contact != nullptr ? rows.row(c.b) : 0;
  moves_a[lane] = rows.moves(a[lane]), moves_b[lane] = rows.moves(b[lane]);
  set3(normal, lane, c.normal);
  set3(tangent[0], lane, c.tangent);
  set3(slide_a[0], lane, middle_a);
  set3(slide_b[0], lane, middle_b);
  for (int k = 0; k < 4; ++k) {
    const bool is = k < c.count;
    set3(arm_a[k], lane, is ? c.points[k].arm_a : middle_a);
    set3(arm_b[k], lane, is ? c.points[k].arm_b : middle_b);
    used[k][lane] = is ? 1 : 0;
    separation[k][lane] = is ? c.points[k].separation : 0;
    impulse[k][lane] = is ? c.points[k].impulse : 0;
    lever[k][lane] = is ? (c.points[k].arm_a - middle_a).norm() : 0;
  }
  friction[lane] = c.friction, spinning[lane] = c.spinning, away[lane] = 0;
  slide_impulse[0][lane] = c.friction_impulse[0], slide_impulse[1][lane] = c.friction_impulse[1];
  twist_impulse[lane] = c.twist_impulse;
  rolls = (lane > 0 && rolls) || c.rolling > 0;
  rolling[lane] = c.rolling;
  for (int i = 0; i < 2; ++i) roll_impulse[i][lane] = c.roll_impulse[i];
}

void ContactPacket::get(int lane, ContactConstraint& contact) const {
  for (int k = 0; k < contact.count; ++k) contact.points[k].impulse = impulse[k][lane];
  contact.friction_impulse[0] = slide_impulse[0][lane];
  contact.friction_impulse[1] = slide_impulse[1][lane];
  contact.twist_impulse = twist_impulse[lane];
  for (int i = 0; i < 2; ++i) contact.roll_impulse[i] = rolls ? roll_impulse[i][lane] : 0;
}

void ContactPacket::prepare(const BodyRows& rows) {
  const Root A(rows, a), B(rows, b);
  scale_a = A.scale, scale_b = B.scale;
  tangent[1] = cross(normal, tangent[0]);
  const V3 ra = slide_a[0], rb = slide_b[0];
  if (rolls) {
    for (int i = 0; i < 2; ++i) roll_a[i] = A * tangent[i], roll_b[i] = B * tangent[i];
  }
  for (int i = 0; i < 2; ++i) {
    slide_a[i] = A * cross(ra, tangent[i]);
    slide_b[i] = B * cross(rb, tangent[i]);
  }
  twist_a = A * normal, twist_b = B * normal;
  for (int k = 0; k < 4; ++k) {
    arm_a[k] = A * cross(arm_a[k], normal);
    arm_b[k] = B * cross(arm_b[k], normal);
  }
  const V mass_a = A.moves * A.scale * A.scale, mass_b = B.moves * B.scale * B.scale;
  const V linear = mass_a + mass_b;
  V largest{};
  for (int k = 0; k < 4; ++k) {
    for (int l = 0; l <= k; ++l) {
      block[at(k, l)] = used[k] * used[l] *
                        (linear + (A.moves * fused_dot(arm_a[k], arm_a[l]) +
                                   B.moves * fused_dot(arm_b[k], arm_b[l])));
    }
    largest = max(largest, block[at(k, k)]);
  }
  for (int k = 0; k < 4; ++k) {
    V& entry = block[at(k, k)];
    entry = used[k] > 0 ? entry + kRegularisation * largest : splat<V>(1);
    diagonal[k] = 1 / entry;
  }
  invert(block, inverse);

  const auto mobility = [&](int i, int j) __attribute__((always_inline)) {
    return A.moves * fused_dot(slide_a[i], slide_a[j]) +
           B.moves * fused_dot(slide_b[i], slide_b[j]);
  };
  const V some = max(linear, splat<V>(1e-300));  // lanes without a contact
  const V xx = some + mobility(0, 0), xy = mobility(0, 1), yy = some + mobility(1, 1);
  const V scale = 1 / (xx * yy - xy * xy);
  slide_inverse[0] = scale * yy, slide_inverse[1] = -scale * xy, slide_inverse[2] = scale * xx;
  slide_bound = 1 / largest_of(xx, xy, yy);
  const V spin = A.moves * fused_dot(twist_a, twist_a) + B.moves * fused_dot(twist_b, twist_b);
  twist_inverse = 1 / max(spin, splat<V>(1e-300));
  if (!rolls) return;
  const auto turning = [&](int i, int j) __attribute__((always_inline)) {
    return A.moves * fused_dot(roll_a[i], roll_a[j]) + B.moves * fused_dot(roll_b[i], roll_b[j]);
  };
  roll_inverse = 1 / max(largest_of(turning(0, 0), turning(0, 1), turning(1, 1)), splat<V>(1e-300));
}

void ContactPacket::warm_start(BodyRows& rows) const {
  Motion6 m = load_motion(rows.push, *this);
  apply_normal(*this, impulse, m);
  apply_friction(*this, slide_impulse, twist_impulse, m);
  if (rolls) apply_rolling(*this, roll_impulse, m);
  store_motion(m, rows.push, *this);
}

void ContactPacket::solve_velocities(BodyRows& rows, const Settings& settings, bool first) {
  V u[4], d[4];
  if (first) {
    approach(*this, load_motion(rows.displacement, *this), u);
    for (int k = 0; k < 4; ++k) {
      target[k] = max(separation[k] + u[k] + away, V{}) * settings.inverse_h;
    }
  }
  Motion6 m = load_motion(rows.velocity, *this);
  if (rolls) solve_rolling(*this, m);
  solve_friction(*this, m);
  approach(*this, m, u);
  for (int k = 0; k < 4; ++k) u[k] = (u[k] + target[k]) * used[k];
  solve_block(*this, u, impulse, d);
  for (int k = 0; k < 4; ++k) impulse[k] = impulse[k] + d[k];
  apply_normal(*this, d, m);
  store_motion(m, rows.velocity, *this);
}

void ContactPacket::solve_positions(BodyRows& rows, const Settings& settings) const {
  Motion6 m = load_motion(rows.displacement, *this);
  V u[4], d[4];
  const V none[4] = {};
  approach(*this, m, u);
  auto deep = u[0] < u[0];
  for (int k = 0; k < 4; ++k) {
    const V C = separation[k] + u[k] + away + settings.slop;
    const auto is = (C < 0) & (used[k] > 0);
    deep = deep | is;
    u[k] = used[k] * (is ? max(settings.correction * C, splat<V>(-settings.push)) : C);
  }
  if (!any(deep)) return;
  solve_block(*this, u, none, d);
  apply_normal(*this, d, m);
  store_motion(m, rows.displacement, *this);
}

}  // namespace substep::rigid
