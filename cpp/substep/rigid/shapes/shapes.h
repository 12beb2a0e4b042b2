// The shapes of rigid bodies, each in a frame of its own: the axis of capsule and cylinder is z,
// the centre of sphere, box, capsule and cylinder is the origin. All but planes and meshes can
// move; these are ground. A new one is a header of its own (shape.h) and a place in the list here.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "substep/rigid/shapes/box.h"
#include "substep/rigid/shapes/capsule.h"
#include "substep/rigid/shapes/convex_hull.h"
#include "substep/rigid/shapes/cylinder.h"
#include "substep/rigid/shapes/plane.h"
#include "substep/rigid/shapes/sphere.h"
#include "substep/rigid/shapes/triangle_mesh.h"

namespace substep::rigid {

using Shape = std::variant<Sphere, Box, Capsule, Cylinder, Plane, std::shared_ptr<const ConvexHull>,
                           std::shared_ptr<const TriangleMesh>>;

// Of the kind with this name, made of these numbers. InputError: there is no such kind, or a number
// is missing; whether they are in range is for check_shape().
Shape make_shape(const std::string& kind, const std::map<std::string, double>& numbers);
// InputError, which begins with `where`: a number is out of range, or there is no hull or mesh.
void check_shape(const Shape& shape, const std::string& where);

// What a body is made of: a shape in the frame of the body. A compound has several.
struct Fixture {
  Shape shape;
  Pose local;
  double friction = 0.5, restitution = 0;
  double density = 1000;                       // [kg/m^3]
  double rolling = 0, spinning = 0;            // levers of friction that resists them [m]
  std::uint32_t group = 1, mask = 0xffffffff;  // a meets b: a.group & b.mask and b.group & a.mask
  std::optional<double> static_friction = {};  // at least friction; the same unless given
  std::string material = {};                   // its name, see MaterialPair; may be empty
};

// The smallest box along the axes that holds the shape; a plane reaches to infinity.
Bounds bounds(const Shape& shape, const Pose& pose);
// A ball that the shape holds, in its middle, in its frame; of infinite radius for planes and
// meshes.
Ball inner_ball(const Shape& shape);
// The largest distance of a point of the shape from the origin of the frame that `local` is in; 0
// for planes, which never turn.
double outer_radius(const Shape& shape, const Pose& local);

// Whether only a body that never moves may have it.
inline bool is_ground(const Shape& shape) {
  return std::holds_alternative<Plane>(shape) ||
         std::holds_alternative<std::shared_ptr<const TriangleMesh>>(shape);
}

}  // namespace substep::rigid
