// The shapes of rigid bodies, each in a frame of its own: the axis of capsule and cylinder is z,
// the centre of sphere, box, capsule and cylinder is the origin. All but the plane can move; that
// is ground.
#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <variant>

#include "substep/rigid/shapes/convex_hull.h"
#include "substep/rigid/shapes/pose.h"
#include "substep/rigid/shapes/triangle_mesh.h"

namespace substep::rigid {

struct Sphere {
  double radius;
};
struct Box {
  Vec3 half_lengths;
};
// The points within `radius` of the segment from (0, 0, -half_length) to (0, 0, half_length).
struct Capsule {
  double radius, half_length;
};
struct Cylinder {
  double radius, half_length;
};
// The half space normal . x <= offset.
struct Plane {
  Vec3 normal;  // of length 1
  double offset;
};

using Shape = std::variant<Sphere, Box, Capsule, Cylinder, Plane, std::shared_ptr<const ConvexHull>,
                           std::shared_ptr<const TriangleMesh>>;

// What a body is made of: a shape in the frame of the body. A compound has several.
struct Fixture {
  Shape shape;
  Pose local;
  double friction = 0.5, restitution = 0;
  double density = 1000;                       // [kg/m^3]
  double rolling = 0, spinning = 0;            // levers of friction that resists them [m]
  std::uint32_t group = 1, mask = 0xffffffff;  // a meets b: a.group & b.mask and b.group & a.mask
};

// The point of a convex shape that is farthest along a direction of any length (not 0); along a
// face or an edge: one of its corners (of its ends).
inline Vec3 support(const Sphere& s, const Vec3& d) { return d * (s.radius / d.norm()); }
inline Vec3 support(const Box& b, const Vec3& d) {
  const auto sign = [](double a, double h) { return a < 0 ? -h : h; };
  return {sign(d.x(), b.half_lengths.x()), sign(d.y(), b.half_lengths.y()),
          sign(d.z(), b.half_lengths.z())};
}
inline Vec3 support(const Capsule& c, const Vec3& d) {
  return d * (c.radius / d.norm()) + Vec3(0, 0, d.z() < 0 ? -c.half_length : c.half_length);
}
inline Vec3 support(const Cylinder& c, const Vec3& d) {
  const double radial = std::hypot(d.x(), d.y()), scale = radial > 0 ? c.radius / radial : 0;
  return {scale * d.x(), scale * d.y(), d.z() < 0 ? -c.half_length : c.half_length};
}
inline Vec3 support(const std::shared_ptr<const ConvexHull>& hull, const Vec3& d) {
  return hull->vertices()[hull->polytope().support_vertex(d)];
}

// The smallest box along the axes that holds the shape; a plane reaches to infinity.
struct Bounds {
  Vec3 low, high;
};
Bounds bounds(const Shape& shape, const Pose& pose);

// Whether only a body that never moves may have it.
inline bool is_ground(const Shape& shape) {
  return std::holds_alternative<Plane>(shape) ||
         std::holds_alternative<std::shared_ptr<const TriangleMesh>>(shape);
}

}  // namespace substep::rigid
