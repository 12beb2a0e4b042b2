// The distance of two shapes.
#pragma once

#include <limits>

#include "substep/rigid/shapes/convex.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

struct ShapeDistance {
  double value;  // [m], 0 where they overlap
  // From a to b, of length 1, 0 where they overlap: the shapes are on different sides of two planes
  // with this normal that are `value` apart.
  Vec3 normal;
};

// Of a convex shape and a convex one or a plane, either way round, by GJK (gjk.h). Of a mesh and a
// convex shape: the least over its triangles, from both sides; normal of the nearest one. Where the
// distance is above `enough` a number between the two may be the answer, which is sooner found.
// InputError for two of planes and meshes.
ShapeDistance shape_distance(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                             double enough = std::numeric_limits<double>::infinity());

// The same of convex views (view.h), and of one with a half space.
ShapeDistance convex_distance(const Convex& a, const Pose& pose_a, const Convex& b,
                              const Pose& pose_b, double enough);
ShapeDistance plane_distance(const Convex& a, const Pose& pose_a, const Plane& b,
                             const Pose& pose_b);

// A triangle of a mesh as a convex shape, in the frame of the mesh.
struct TriangleView {
  TriangleView(const TriangleMesh& mesh, int triangle);
  TriangleView(const TriangleView&) = delete;

  TrianglePolytope arrays;
  Convex convex;
};

}  // namespace substep::rigid
