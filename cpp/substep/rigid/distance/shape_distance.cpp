#include "substep/rigid/distance/shape_distance.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/rigid/distance/gjk.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

ShapeDistance mesh_distance(const Convex& a, const Pose& pose_a, const Bounds& bounds_a,
                            const TriangleMesh& mesh, const Pose& pose_b, double enough) {
  // Triangles about the shape, in a box that grows until the nearest must be among them.
  const double whole = (mesh.high() - mesh.low()).norm() + (bounds_a.high - bounds_a.low).norm() +
                       (bounds_a.low - mesh.low()).norm();
  double reach = std::min(enough, std::max((bounds_a.high - bounds_a.low).norm(), 1e-3 * whole));
  for (;; reach *= 4) {
    ShapeDistance nearest{kInfinity, Vec3::Zero()};
    const Vec3 room = Vec3::Constant(reach);
    mesh.for_each_in(bounds_a.low - room, bounds_a.high + room, [&](int t) {
      const TriangleView triangle(mesh, t);
      const ShapeDistance d =
          convex_distance(a, pose_a, triangle.convex, pose_b, std::min(enough, nearest.value));
      if (d.value < nearest.value) nearest = d;
    });
    if (nearest.value <= reach) return nearest;
    if (reach >= enough || reach > whole) {
      // All others are further than `reach`, which may be 0.
      return nearest.value < kInfinity ? nearest
                                       : ShapeDistance{std::max(reach, 1e-300), Vec3::Zero()};
    }
  }
}

struct DistanceOf {
  const Pose &pose_a, &pose_b;
  double enough;

  template <class A, class B>
  ShapeDistance operator()(const A& a, const B& b) const {
    if constexpr (ConvexShape<A> && ConvexShape<B>) {
      const View<A> view_a(a);
      const View<B> view_b(b);
      return convex_distance(view_a.convex, pose_a, view_b.convex, pose_b, enough);
    } else if constexpr (ConvexShape<A> && std::is_same_v<B, Plane>) {
      return plane_distance(View<A>(a).convex, pose_a, b, pose_b);
    } else if constexpr (ConvexShape<A>) {
      return mesh_distance(View<A>(a).convex, pose_a, bounds(a, pose_a.relative_to(pose_b)), *b,
                           pose_b, enough);
    } else if constexpr (ConvexShape<B>) {
      ShapeDistance flipped = DistanceOf{pose_b, pose_a, enough}(b, a);
      flipped.normal = -flipped.normal;
      return flipped;
    } else {
      throw InputError("planes and meshes have no distance to each other");
    }
  }
};

}  // namespace

ShapeDistance convex_distance(const Convex& a, const Pose& pose_a, const Convex& b,
                              const Pose& pose_b, double enough) {
  const Difference difference{a, b, pose_b.relative_to(pose_a)};
  const double rounding = a.rounding + b.rounding;
  const Distance cores = distance(difference, difference.pose_b.position, enough + rounding);
  const double value = cores.value - rounding;
  if (!(value > 0)) return {0, Vec3::Zero()};
  return {value, pose_a.rotation * cores.normal};
}

ShapeDistance plane_distance(const Convex& a, const Pose& pose_a, const Plane& b,
                             const Pose& pose_b) {
  const Vec3 outward = pose_b.rotation * b.normal;
  const Vec3 deepest = pose_a.to_world(a.support(-(pose_a.rotation.transpose() * outward)));
  const double value = outward.dot(deepest - pose_b.position) - b.offset - a.rounding;
  if (!(value > 0)) return {0, Vec3::Zero()};
  return {value, -outward};
}

TriangleView::TriangleView(const TriangleMesh& mesh, int triangle)
    : arrays(mesh.vertices()[mesh.face(triangle)[0]], mesh.vertices()[mesh.face(triangle)[1]],
             mesh.vertices()[mesh.face(triangle)[2]]),
      convex{
          .core = Convex::Core::polytope, .polytope = arrays.polytope(), .size = 0, .extent = 0} {
  for (const Vec3& v : arrays.vertices) convex.extent = std::max(convex.extent, v.norm());
}

ShapeDistance shape_distance(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                             double enough) {
  return std::visit(DistanceOf{pose_a, pose_b, enough}, a, b);
}

}  // namespace substep::rigid
