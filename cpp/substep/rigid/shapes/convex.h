// One view of all convex shapes for the algorithms that need no more than a support function: a
// core (polytope, segment along z, cylinder about z) with `rounding` around it.
#pragma once

#include "substep/rigid/shapes/polytope.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

struct Convex {
  enum class Core { polytope, segment, cylinder };

  Core core;
  double radius = 0, half_length = 0;  // of segment and cylinder
  Polytope polytope;
  Vec3 centre = Vec3::Zero();  // a point inside
  double rounding = 0;
  double size;    // the smallest half length: the scale of tolerances
  double extent;  // the largest distance from the origin of the frame

  // The point of the core farthest along d; d may be 0.
  Vec3 support(const Vec3& d) const {
    switch (core) {
      case Core::polytope:
        return polytope.vertices[polytope.support_vertex(d)];
      case Core::segment:
        return {0, 0, d.z() < 0 ? -half_length : half_length};
      case Core::cylinder:
        break;
    }
    const double square = d.x() * d.x() + d.y() * d.y();
    const double scale = square > 0 ? radius / std::sqrt(square) : 0;
    return {scale * d.x(), scale * d.y(), d.z() < 0 ? -half_length : half_length};
  }
};

inline Convex convex(const Sphere& s) {
  return {.core = Convex::Core::segment,
          .polytope = {},
          .rounding = s.radius,
          .size = s.radius,
          .extent = 0};
}
inline Convex convex(const Capsule& c) {
  return {.core = Convex::Core::segment,
          .half_length = c.half_length,
          .polytope = {},
          .rounding = c.radius,
          .size = c.radius,
          .extent = c.half_length};
}
inline Convex convex(const Cylinder& c) {
  return {.core = Convex::Core::cylinder,
          .radius = c.radius,
          .half_length = c.half_length,
          .polytope = {},
          .size = std::min(c.radius, c.half_length),
          .extent = std::hypot(c.radius, c.half_length)};
}
inline Convex convex(const ConvexHull& hull) {
  return {.core = Convex::Core::polytope,
          .polytope = hull.polytope(),
          .centre = hull.centre(),
          .size = hull.thickness(),
          .extent = hull.radius()};
}
// The arrays of the box must live as long.
inline Convex convex(const Box& box, const BoxPolytope& arrays) {
  return {.core = Convex::Core::polytope,
          .polytope = arrays.polytope(),
          .size = box.half_lengths.minCoeff(),
          .extent = box.half_lengths.norm()};
}

}  // namespace substep::rigid
