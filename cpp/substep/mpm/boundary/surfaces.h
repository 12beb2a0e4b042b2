// What a particle does at a surface of a collider (geometry/surfaces.h).
#pragma once

#include <algorithm>

#include "substep/geometry/conservative_advancement.h"
#include "substep/geometry/surfaces.h"

namespace substep::mpm {

using geometry::half_length;
using geometry::lipschitz;
using geometry::local_distance;
using geometry::signed_distance;
using geometry::Surface;
using geometry::surfaces;

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
