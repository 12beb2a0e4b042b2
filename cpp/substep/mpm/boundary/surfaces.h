// The surfaces of colliders that a node or a particle can touch. A collider has one, but a hollow
// box has three pairs of walls, so that in its edges and corners each wall acts, with its normal.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/geometry/conservative_advancement.h"

namespace substep::mpm {

struct Surface {
  std::size_t collider;
  int axis = -1;  // of the collider's frame, to which a pair of walls is perpendicular; -1: all
};

inline std::vector<Surface> surfaces(std::span<const geometry::Collider> colliders) {
  std::vector<Surface> all;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    if (colliders[c].hollow() && std::holds_alternative<geometry::Box>(colliders[c].shape())) {
      for (int axis = 0; axis < 3; ++axis) all.push_back({c, axis});
    } else {
      all.push_back({c});
    }
  }
  return all;
}

// From the collider's middle plane to a wall [m].
inline double half_length(const geometry::Collider& collider, int axis) {
  return std::get<geometry::Box>(collider.shape()).half_lengths[axis];
}

// As Collider::local_distance.
inline geometry::SignedDistance local_distance(const geometry::Collider& collider, int axis,
                                               const geometry::Vec3& x) {
  if (axis < 0) return collider.local_distance(x);
  return {half_length(collider, axis) - std::abs(x[axis]),
          (x[axis] < 0 ? 1.0 : -1.0) * geometry::Vec3::Unit(axis)};
}
inline geometry::SignedDistance signed_distance(const geometry::Collider& collider, int axis,
                                                const geometry::Vec3& x) {
  const geometry::Vec3 local = collider.rotation().transpose() * (x - collider.position());
  const geometry::SignedDistance d = local_distance(collider, axis, local);
  return {d.value, collider.rotation() * d.gradient};
}
inline double lipschitz(const geometry::Collider& collider, int axis) {
  return axis < 0 ? collider.lipschitz() : 1;
}

// In the frame of the collider, where a particle that was at `from` ends on its way to `to`, at
// least `margin` from the surface; or where one that was inside is pushed to.
inline geometry::Vec3 held_off(const geometry::Collider& collider, int axis,
                               const geometry::Vec3& from, const geometry::Vec3& to, double margin,
                               bool inside) {
  if (axis < 0) {
    return inside ? geometry::push_out(collider, to, margin)
                  : geometry::advance_freely(collider, from, to, margin);
  }
  const double room = std::max(half_length(collider, axis) - margin, 0.0);
  geometry::Vec3 p = to;
  p[axis] = std::clamp(p[axis], -room, room);
  return p;
}

}  // namespace substep::mpm
