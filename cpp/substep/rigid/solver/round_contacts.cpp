#include "substep/rigid/solver/round_contacts.h"

#include "substep/core/usize.h"
#include "substep/rigid/solver/contact_lanes.h"

namespace substep::rigid {
namespace {

using Lanes = RoundContacts::V;
using Lanes3 = RoundContacts::V3;
using LaneMask = RoundContacts::Mask;

constexpr double kParallel = 1e-2;  // [rad], of axes that the narrow phase takes for parallel
constexpr double kMeets = 1e-9;     // of a radius: closer axes have no direction

SUBSTEP_INLINE Lanes unit_interval(const Lanes& x) {
  const Lanes low = x < -1.0 ? splat<Lanes>(-1) : x;
  return low > 1.0 ? splat<Lanes>(1) : low;
}
SUBSTEP_INLINE Lanes length(const Lanes3& x) { return square_root(fused_dot(x, x)); }
SUBSTEP_INLINE Lanes3 choose(const LaneMask& is, const Lanes3& x, const Lanes3& y) {
  return {{is ? x[0] : y[0], is ? x[1] : y[1], is ? x[2] : y[2]}};
}
SUBSTEP_INLINE Lanes3 times(const Lanes& s, const Lanes3& x) {
  return {{s * x[0], s * x[1], s * x[2]}};
}
// A quotient that does not count where its divisor is 0.
SUBSTEP_INLINE Lanes over(const Lanes& x, const Lanes& y) {
  return x / (y > 0 ? y : splat<Lanes>(1));
}
// Not a part of what calls it, where it would take registers.
[[gnu::noinline]] QuaternionLanes<Lanes> turn_far_by(const Lanes3& w) { return rotation_by(w); }
// rotation_by(), sooner where all turns are below half a radian: by the series of sine and cosine.
SUBSTEP_INLINE QuaternionLanes<Lanes> turn_by(const Lanes3& w) {
  const Lanes z = 0.25 * fused_dot(w, w);
  if (any(z > 0.0625)) return turn_far_by(w);
  Lanes sine = fma(z, splat<Lanes>(-1. / 39916800), 1. / 362880);
  sine = fma(z, fma(z, fma(z, fma(z, sine, -1. / 5040), 1. / 120), -1. / 6), 1.);
  Lanes cosine = fma(z, splat<Lanes>(-1. / 3628800), 1. / 40320);
  cosine = fma(z, fma(z, fma(z, fma(z, cosine, -1. / 720), 1. / 24), -1. / 2), 1.);
  return {cosine, times(0.5 * sine, w)};
}
Vec3 of_lane(const Lanes3& x, int lane) { return {x[0][lane], x[1][lane], x[2][lane]}; }
void set_lane(Lanes3& x, int lane, const Vec3& value) {
  for (int i = 0; i < 3; ++i) x[i][lane] = value[i];
}

}  // namespace

void RoundContacts::clear() {
  a_ = b_ = Side{};
  acts_ = margin_ = V{};
  has_ = left_ = found_ = Mask{};
}

void RoundContacts::add(int lane, const RoundPair& pair, const ContactConstraint& contact,
                        const Bodies& bodies) {
  const auto set = [&](Side& side, const RoundShape& shape, std::int32_t body) {
    const Vec3 position = bodies.position(body);
    const double* const q = &bodies.q[4 * usize(body)];
    set_lane(side.position, lane, position);
    set_lane(side.centre, lane, shape.centre - position);
    set_lane(side.along, lane, shape.along);
    side.radius[lane] = shape.radius;
    side.plane[lane] = shape.plane ? -1 : 0;
    side.rotation.w[lane] = q[0];
    set_lane(side.rotation.v, lane, Vec3(q + 1));
  };
  set(a_, pair.a, contact.a);
  set(b_, pair.b, contact.b);
  acts_[lane] = pair.acts, margin_[lane] = contact.margin;
  has_[lane] = -1;
}

RoundContacts::Placed RoundContacts::place(const Side& side, bool moves, const std::int32_t* index,
                                           const BodyRows& rows) {
  if (!moves) {
    return {side.position, {splat<V>(1), {}}, side.position + side.centre, side.along, {}, {}};
  }
  const RootLanes root(rows, index);
  const auto load = [&](const BodyRows::Rows& of) __attribute__((always_inline)) {
    return load_bodies([&](int lane) { return of.data() + index[lane]; });
  };
  const BodyLanes x = load(rows.displacement), v = load(rows.velocity);
  Placed placed;
  placed.position = fused_sum(side.position, root.scale, x.linear);
  placed.turned = turn_by(root * x.angular);
  placed.centre = placed.position + placed.turned.rotated(side.centre);
  placed.along = placed.turned.rotated(side.along);
  placed.velocity = times(root.scale, v.linear);
  placed.spin = root * v.angular;
  return placed;
}

// Both ends, along the normal m of the plane.
void RoundContacts::touch_plane(const Placed& a, const Placed& b, Touch& touch) const {
  const Mask plane_a = a_.plane, is = a_.plane | b_.plane;
  const V3 m = choose(plane_a, a.along, b.along), foot = choose(plane_a, a.centre, b.centre);
  const V3 c = choose(plane_a, b.centre, a.centre), d = choose(plane_a, b.along, a.along);
  const V radius = plane_a ? b_.radius : a_.radius;
  const V height = fused_dot(m, c - foot) - radius, slope = fused_dot(m, d);
  touch.normal = choose(is, times(plane_a ? splat<V>(1) : splat<V>(-1), m), touch.normal);
  for (int k = 0; k < 2; ++k) {
    const V end = splat<V>(k == 0 ? -1 : 1), C = fma(end, slope, height);
    const V3 middle = fused_sum(fused_sum(c, end, d), -(radius + 0.5 * C), m);
    touch.separation[k] = is ? C : touch.separation[k];
    touch.middle[k] = choose(is, middle, touch.middle[k]);
  }
  touch.two = is & (fused_dot(d, d) > 0);
}

// With r = c_a - c_b, |r + s d_a - t d_b| is least for
//   s = ((d_a.d_b) (d_b.r) - (d_a.r) |d_b|^2) / (|d_a|^2 |d_b|^2 - (d_a.d_b)^2)
// and t = ((d_a.d_b) s + d_b.r) / |d_b|^2, or s of that t where it is beyond an end.
void RoundContacts::touch_segments(const Placed& a, const Placed& b, Touch& touch) const {
  const V3 r = a.centre - b.centre, &u = a.along, &v = b.along;
  const V aa = fused_dot(u, u), bb = fused_dot(v, v), ab = fused_dot(u, v);
  const V ar = fused_dot(u, r), br = fused_dot(v, r);
  const V crossing = aa * bb - ab * ab;
  const Mask long_a = aa > 0, long_b = bb > 0;
  V s = crossing > 0 ? unit_interval(over(ab * br - ar * bb, crossing)) : V{};
  V t = long_b ? over(fma(ab, s, br), bb) : V{};
  const Mask ends = ~long_b | (t < -1.0) | (t > 1.0);
  t = unit_interval(t);
  s = ends ? (long_a ? unit_interval(over(fma(ab, t, -ar), aa)) : V{}) : s;
  const V3 p = fused_sum(a.centre, s, u), q = fused_sum(b.centre, t, v), d = q - p;
  const V distance = length(d);
  const V3 across = fused_cross(u, v);
  const V square = fused_dot(across, across);
  const Mask cross = long_a & long_b & (s > -1.0) & (s < 1.0) & (t > -1.0) & (t < 1.0);
  const V side = fused_dot(across, d) < 0 ? splat<V>(-1) : splat<V>(1);
  const Mask parallel = long_a & long_b & (square < (kParallel * kParallel) * (aa * bb));
  touch.fails = parallel | (~cross & ~(distance > kMeets * a_.radius));
  const V scale = cross ? over(side, square_root(square)) : over(splat<V>(1), distance);
  touch.normal = times(scale, choose(cross, across, d));
  const V C = distance - a_.radius - b_.radius;
  touch.separation[0] = touch.separation[1] = C;
  touch.middle[0] = touch.middle[1] = fused_sum(p, a_.radius + 0.5 * C, touch.normal);
}

void RoundContacts::find(const BodyRows& rows, double h, ContactPacket& packet) {
  const Placed a = place(a_, packet.has_a, packet.a, rows),
               b = place(b_, packet.has_b, packet.b, rows);
  const Mask ground = a_.plane | b_.plane;
  Touch touch{};
  if (any(has_ & ~ground)) touch_segments(a, b, touch);
  touch.fails = touch.fails & has_ & ~ground;
  if (any(ground)) touch_plane(a, b, touch);
  left_ = touch.fails;
  if (any(left_)) {
    if (any(found_)) finish(rows, packet);
    last_ = now_;
    has_ = has_ & ~left_;
  }

  const auto nearer = touch.two & (touch.separation[1] < touch.separation[0]);
  const V nearest = nearer ? touch.separation[1] : touch.separation[0];
  const Mask is_nearest[2] = {~nearer, nearer};
  const Mask within[2] = {~nearer | (touch.separation[0] <= margin_),
                          touch.two & (nearer | (touch.separation[1] <= margin_))};

  // Impulses are those of the same ends; of one end that came or went, the nearer one has all.
  const V3& n = touch.normal;
  const V3 along = fused_sum(packet.tangent, -fused_dot(n, packet.tangent), n);
  const V square = fused_dot(along, along);
  const Mask same = square > kSameTangent;
  const V3 t = choose(same, times(over(splat<V>(1), square_root(square)), along),
                      substep::detail::perpendicular(n));
  const V kept = same ? splat<V>(1) : V{};
  const Mask both = within[0] & within[1] & (wide(packet.used[0]) > 0) &
                    (wide(packet.used[1]) > 0) & ~(wide(packet.used[2]) > 0);
  const V all = packet.pressure();
  const auto put = [&](V& x, const V& value)
                       __attribute__((always_inline)) { x = has_ ? value : x; };
  const auto put_narrow = [&](ContactPacket::F& x, const V& value) __attribute__((always_inline)) {
    x = narrow(has_ ? value : wide(x));
  };
  V l[2];
  for (int k = 0; k < 2; ++k)
    l[k] = kept * (both ? packet.impulse[k] : (is_nearest[k] ? all : V{}));
  for (V& x : packet.slide_impulse) put(x, kept * x);
  for (V& x : packet.roll_impulse) put(x, kept * x);
  put(packet.twist_impulse, kept * packet.twist_impulse);

  // Only points that press or that this sub-step may reach act.
  const V3 v = b.velocity - a.velocity;
  V3 arm_a[2], arm_b[2];
  Mask acts[2];
  for (int k = 0; k < 2; ++k) {
    const V3 at = fused_sum(touch.middle[k], (acts_ - 0.5) * touch.separation[k], n);
    arm_a[k] = at - a.position, arm_b[k] = at - b.position;
    const V3 u = v + fused_cross(b.spin, arm_b[k]) - fused_cross(a.spin, arm_a[k]);
    const V reached = fma(splat<V>(h), fused_dot(n, u), touch.separation[k]);
    acts[k] =
        within[k] & (is_nearest[k] | (l[k] > 0) | (touch.separation[k] <= nearest + kReached) |
                     (reached <= (nearest > 0 ? nearest : V{})));
  }

  const V one = splat<V>(1);
  const V part[2] = {acts[0] ? (acts[1] ? 0.5 * one : one) : V{},
                     acts[1] ? (acts[0] ? 0.5 * one : one) : V{}};
  const V3 second = fused_cross(n, t);
  const auto axes = [&](const V3& x) __attribute__((always_inline)) {
    return V3{{fused_dot(x, t), fused_dot(x, second), fused_dot(x, n)}};
  };
  const auto mean = [&](const V3(&arm)[2]) __attribute__((always_inline)) {
    return fused_sum(times(part[0], arm[0]), part[1], arm[1]);
  };
  const V3 middle_a = mean(arm_a), seen_a = axes(middle_a), seen_b = axes(mean(arm_b));
  for (int i = 0; i < 3; ++i) {
    put(packet.normal[i], n[i]);
    put(packet.tangent[i], t[i]);
    put_narrow(packet.arm_a[i], seen_a[i]);
    put_narrow(packet.arm_b[i], seen_b[i]);
  }
  for (int k = 0; k < 4; ++k) {
    V p{}, q{}, C = splat<V>(ContactPacket::kFarAway), used{}, pressing{};
    if (k < 2) {
      const V3 r = axes(arm_a[k & 1] - middle_a);
      const Mask is = acts[k & 1];
      p = is ? r[0] : V{}, q = is ? r[1] : V{};
      C = is ? touch.separation[k & 1] : C, pressing = is ? l[k & 1] : V{};
      used = is ? one : V{};
    }
    put_narrow(packet.p[k], p);
    put_narrow(packet.q[k], q);
    put_narrow(packet.lever[k], square_root(fma(p, p, q * q)));
    put_narrow(packet.used[k], used);
    put_narrow(packet.separation[k], C);
    put(packet.impulse[k], pressing);
  }
  for (int k = 0; k < 2; ++k) {
    now_.middle[k] = touch.middle[k], now_.separation[k] = touch.separation[k];
  }
  now_.position_a = a.position, now_.position_b = b.position;
  now_.turned_a = a.turned, now_.turned_b = b.turned;
  found_ = has_ | (found_ & left_);
}

void RoundContacts::finish(const BodyRows& rows, const ContactPacket& packet) {
  packet.find_separations(rows, separation_);
  for (int k = 0; k < 2; ++k) {
    const V3 a = now_.middle[k] - now_.position_a, b = now_.middle[k] - now_.position_b;
    in_a_[k] = a_.rotation.conjugate().rotated(now_.turned_a.conjugate().rotated(a));
    in_b_[k] = b_.rotation.conjugate().rotated(now_.turned_b.conjugate().rotated(b));
  }
}

void RoundContacts::report(int lane, const ContactPacket& packet,
                           ContactConstraint& contact) const {
  if (found_[lane] == 0) return;
  const Found& found = left(lane) ? last_ : now_;
  contact.normal = of_lane(packet.normal, lane);
  contact.tangent = of_lane(packet.tangent, lane);
  contact.count = 0;
  for (int k = 0; k < 2; ++k) {
    if (!(packet.used[k][lane] > 0)) continue;
    ContactConstraint::Point& point = contact.points[contact.count++];
    point.position = of_lane(found.middle[k], lane);
    point.separation = separation_[k][lane];
    point.impulse = packet.impulse[k][lane];
    point.in_a = of_lane(in_a_[k], lane), point.in_b = of_lane(in_b_[k], lane);
    const Vec3 at =
        point.position + (acts_[lane] - 0.5) * found.separation[k][lane] * contact.normal;
    point.arm_a = at - of_lane(found.position_a, lane);
    point.arm_b = at - of_lane(found.position_b, lane);
  }
}

}  // namespace substep::rigid
