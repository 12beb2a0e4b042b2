// The surfaces of colliders that a node, a particle or a vertex can touch. A collider has one, but
// a hollow box has three pairs of walls, so that in its edges and corners each wall acts, with its
// normal.
#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"

namespace substep::geometry {

struct Surface {
  std::size_t collider;
  int axis = -1;  // of the collider's frame, to which a pair of walls is perpendicular; -1: all
};

inline std::vector<Surface> surfaces(std::span<const Collider> colliders, bool cylinders = false) {
  std::vector<Surface> all;
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    if (colliders[c].hollow() && std::holds_alternative<Box>(colliders[c].shape())) {
      for (int axis = 0; axis < 3; ++axis) all.push_back({c, axis});
    } else if (cylinders && colliders[c].hollow() &&
               std::holds_alternative<Cylinder>(colliders[c].shape())) {
      all.insert(all.end(), {{c, 0}, {c, 2}});
    } else {
      all.push_back({c});
    }
  }
  return all;
}

// From the collider's middle plane to a wall [m].
inline double half_length(const Collider& collider, int axis) {
  const auto* cylinder = std::get_if<Cylinder>(&collider.shape());
  return cylinder ? cylinder->half_length : std::get<Box>(collider.shape()).half_lengths[axis];
}

// The side of a hollow cylinder, as that of one without ends; nothing for all other surfaces.
inline std::optional<Cylinder> side(const Collider& collider, int axis) {
  const auto* cylinder = std::get_if<Cylinder>(&collider.shape());
  if (cylinder == nullptr || axis != 0) return {};
  return Cylinder{cylinder->radius, std::numeric_limits<double>::infinity()};
}

// As Collider::local_distance.
inline SignedDistance local_distance(const Collider& collider, int axis, const Vec3& x) {
  if (axis < 0) return collider.local_distance(x);
  if (const auto round = side(collider, axis)) {
    const SignedDistance d = round->signed_distance(x);
    return {-d.value, -d.gradient};
  }
  return {half_length(collider, axis) - std::abs(x[axis]),
          (x[axis] < 0 ? 1.0 : -1.0) * Vec3::Unit(axis)};
}
inline SignedDistance signed_distance(const Collider& collider, int axis, const Vec3& x) {
  const Vec3 local = collider.rotation().transpose() * (x - collider.position());
  const SignedDistance d = local_distance(collider, axis, local);
  return {d.value, collider.rotation() * d.gradient};
}
inline Mat3 hessian(const Collider& collider, int axis, const Vec3& x) {
  if (axis < 0) return collider.hessian(x);
  const auto round = side(collider, axis);
  if (!round) return Mat3::Zero();
  const Mat3& turn = collider.rotation();
  return -(turn * round->hessian(turn.transpose() * (x - collider.position())) * turn.transpose());
}
inline double lipschitz(const Collider& collider, int axis) {
  return axis < 0 ? collider.lipschitz() : 1;
}

}  // namespace substep::geometry
