#include "substep/rigid/solver/contact_constraint.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace substep::rigid {

ContactConstraint make_contact(const Manifold& manifold, std::int32_t a, const Pose& pose_a,
                               std::int32_t b, const Pose& pose_b, double part) {
  ContactConstraint contact;
  contact.a = a, contact.b = b;
  contact.normal = manifold.normal;
  contact.tangent = manifold.normal.unitOrthogonal();
  contact.count = manifold.count;
  for (int k = 0; k < manifold.count; ++k) {
    const ContactPoint& from = manifold.points[k];
    ContactConstraint::Point& point = contact.points[k];
    point.position = 0.5 * (from.on_a + from.on_b);
    point.separation = from.separation;
    point.in_a = pose_a.to_local(point.position);
    point.in_b = pose_b.to_local(point.position);
    const Vec3 acts = from.on_a + part * (from.on_b - from.on_a);
    point.arm_a = acts - pose_a.position;
    point.arm_b = acts - pose_b.position;
  }
  return contact;
}

bool holds(const ContactConstraint& contact) {
  constexpr double kPart = 0.9;
  const Vec3 middle = contact.middle(&ContactConstraint::Point::position);
  int pressing = 0;
  double pressure = 0, lever = 0;
  for (int k = 0; k < contact.count; ++k) {
    const ContactConstraint::Point& point = contact.points[k];
    pressing += point.impulse > 0;
    pressure += point.impulse;
    lever += point.impulse * (point.position - middle).norm();
  }
  const double friction = std::hypot(contact.friction_impulse[0], contact.friction_impulse[1]);
  const double torque = contact.mu() * lever + contact.spinning * pressure;
  return pressing >= 3 && friction < kPart * contact.mu() * pressure &&
         std::abs(contact.twist_impulse) < kPart * torque;
}

void carry_impulses(const ContactConstraint& last, ContactConstraint& now) {
  const Vec3 tangent = last.tangent - now.normal * now.normal.dot(last.tangent);
  if (last.count == 0 || now.count == 0 || !(tangent.squaredNorm() > 0.25)) return;
  now.tangent = tangent.normalized();
  for (int i = 0; i < 2; ++i) {
    now.friction_impulse[i] = last.friction_impulse[i];
    now.roll_impulse[i] = last.roll_impulse[i];
  }
  now.twist_impulse = last.twist_impulse;
  now.load = last.load;
  now.slips = last.slips;
  std::copy_n(last.slip, 3, now.slip);

  // Of the two ends of a short edge that rolls on, one may press: the deeper one has it all.
  if (now.count + last.count == 3 && std::min(now.count, last.count) == 1) {
    const auto deepest =
        std::min_element(now.points, now.points + now.count,
                         [](const auto& p, const auto& q) { return p.separation < q.separation; });
    for (int k = 0; k < last.count; ++k) deepest->impulse += last.points[k].impulse;
    return;
  }
  // Half the distance to the middle, squared; a single point is always the same.
  double near = now.count == 1 && last.count == 1 ? std::numeric_limits<double>::infinity() : 0;
  const Vec3 middle = now.middle(&ContactConstraint::Point::position);
  const Vec3 moved = middle - last.middle(&ContactConstraint::Point::position);
  for (int k = 0; k < now.count; ++k)
    near = std::max(near, 0.25 * (now.points[k].position - middle).squaredNorm());
  const auto distance = [&](int k, int l) {
    const ContactConstraint::Point &x = now.points[k], &y = last.points[l];
    return std::min({(x.in_a - y.in_a).squaredNorm(), (x.in_b - y.in_b).squaredNorm(),
                     (x.position - y.position - moved).squaredNorm()});
  };
  bool taken[4] = {};
  for (int k = 0; k < now.count; ++k) {
    int best = -1;
    if (k < last.count && !taken[k] && distance(k, k) <= 0.01 * near) {
      best = k;  // as almost always
    } else {
      double least = near;
      for (int l = 0; l < last.count; ++l) {
        const double d = taken[l] ? near : distance(k, l);
        if (!taken[l] && d <= least) least = d, best = l;
      }
    }
    if (best < 0) continue;
    taken[best] = true;
    now.points[k].impulse = last.points[best].impulse;
  }
}

}  // namespace substep::rigid
