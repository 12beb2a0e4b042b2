// Where a ray meets a shape.
//
// It meets a surface only from outside: one that begins within a solid does not meet it, one that
// comes from behind a triangle of a mesh goes through. A ray that only touches may meet or not.
#pragma once

#include <limits>
#include <optional>

#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// origin + t direction for 0 <= t <= length
struct Ray {
  Vec3 origin, direction;  // direction: of length 1
  double length = std::numeric_limits<double>::infinity();

  Vec3 at(double t) const { return origin + t * direction; }
};

struct RayHit {
  double distance;  // t [m]
  Vec3 normal;      // of the surface, of length 1, against the ray
};

std::optional<RayHit> ray_cast(const Shape& shape, const Pose& pose, const Ray& ray);

}  // namespace substep::rigid
