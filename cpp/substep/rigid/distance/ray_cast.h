// Where a ray meets a shape.
//
// It meets a surface only from outside: one that begins within a solid does not meet it, one that
// comes from behind a triangle of a mesh goes through. A ray that only touches may meet or not.
#pragma once

#include <optional>

#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

std::optional<RayHit> ray_cast(const Shape& shape, const Pose& pose, const Ray& ray);

// By support points alone, in the frame of the shape: from plane to plane, each of which touches
// the shape where it is nearest to the point that the ray has reached (van den Bergen, "Ray casting
// against general convex objects with application to continuous collision detection", 2004). Up to
// 1e-7 of the sizes.
std::optional<RayHit> cast_by_support(const Convex& shape, const Ray& ray);

}  // namespace substep::rigid
