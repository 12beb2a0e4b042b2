#include "substep/geometry/conservative_advancement.h"

#include <algorithm>
#include <optional>

#include "substep/geometry/surely_beyond.h"

namespace substep::geometry {
namespace {

constexpr double kSpent = 0.9;       // of the free ball about a point, in one advance
constexpr double kPrecision = 1e-6;  // of the margin, where pushing ends

// The nearest point at least `margin` from the obstacle, where the free space is convex.
std::optional<Vec3> nearest_free(const Collider& collider, const Vec3& x, double margin) {
  if (const auto* plane = std::get_if<Plane>(&collider.shape())) {
    const double short_of = margin - plane->normal.dot(x);
    return short_of > 0 ? Vec3(x + short_of * plane->normal) : x;
  }
  if (!collider.hollow()) return {};
  if (const auto* box = std::get_if<Box>(&collider.shape())) {
    const Vec3 room = (box->half_lengths.array() - margin).max(0.0);
    return Vec3(x.cwiseMax(-room).cwiseMin(room));
  }
  if (const auto* sphere = std::get_if<Sphere>(&collider.shape())) {
    const double room = std::max(sphere->radius - margin, 0.0), length = x.norm();
    return length > room ? Vec3(x * (room / length)) : x;
  }
  return {};
}

}  // namespace

Vec3 push_out(const Collider& collider, const Vec3& x, double margin) {
  constexpr int kMaxPushes = 12;
  const double lipschitz = collider.lipschitz();
  Vec3 p = x;
  for (int push = 0; push < kMaxPushes; ++push) {
    const auto [d, gradient] = collider.local_distance(p);
    const double slope = gradient.norm();
    if (!(d < margin * (1 - kPrecision)) || slope == 0) break;
    // From outside never further than is free: the gap may be narrower than the margin.
    const double wanted = (margin - d) / slope;
    p += (d > 0 ? std::min(wanted, d / lipschitz) : wanted) / slope * gradient;
  }
  return p;
}

Vec3 set_off(const Collider& collider, const Vec3& x, double margin) {
  const auto nearest = nearest_free(collider, x, margin);
  return nearest ? *nearest : push_out(collider, x, margin);
}

Vec3 advance_freely(const Collider& collider, const Vec3& from, const Vec3& to, double margin) {
  if (const auto nearest = nearest_free(collider, to, margin)) return *nearest;
  if (surely_beyond(collider, to, std::max(margin, (to - from).norm()))) return to;
  const double lipschitz = collider.lipschitz();
  double d = collider.local_distance(to).value;
  if (lipschitz * (to - from).norm() < d) {  // the whole way is free
    return d >= margin ? to : push_out(collider, to, margin);
  }
  Vec3 p = from, target = to;
  d = collider.local_distance(p).value;
  if (!(d > 0)) {  // the obstacle was put here
    p = push_out(collider, p, margin);
    d = collider.local_distance(p).value;
  }
  for (int advance = 0; advance < kMaxAdvances; ++advance) {
    const Vec3 way = target - p;
    const double reach = kSpent * d, length = lipschitz * way.norm();
    const bool arrives = length <= reach;
    if (!arrives && !(reach > 0)) break;  // pushing did not help: stay
    p = arrives ? target : Vec3(p + reach / length * way);
    const SignedDistance at = collider.local_distance(p);
    d = at.value;
    if (d < margin) {
      p = push_out(collider, p, margin);
      d = collider.local_distance(p).value;
      const double slope2 = at.gradient.squaredNorm();
      const double inward = at.gradient.dot(target - p);
      if (slope2 > 0 && inward < 0) target -= inward / slope2 * at.gradient;
    }
    if (arrives) break;
  }
  return p;
}

}  // namespace substep::geometry
