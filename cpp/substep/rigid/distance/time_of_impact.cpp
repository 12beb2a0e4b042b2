#include "substep/rigid/distance/time_of_impact.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/core/quaternion.h"
#include "substep/rigid/distance/shape_distance.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {
namespace {

constexpr int kMaxAdvances = 200;

double reach(const Convex& shape, const Course& course) {
  return course.local.position.norm() + shape.extent;
}

// Two moving things. distance(t, enough): of them then.
struct Approach {
  const Course &a, &b;
  double reach_a, reach_b;  // r_a, r_b
  double target, tolerance;

  double mu(const Vec3& n) const {
    return (a.travel - b.travel).dot(n) + n.cross(a.turn).norm() * reach_a +
           n.cross(b.turn).norm() * reach_b;
  }

  template <class DistanceAt>
  Impact advance(double until, DistanceAt&& distance) const {
    const double most =
        (a.travel - b.travel).norm() + a.turn.norm() * reach_a + b.turn.norm() * reach_b;
    Impact impact;
    double t = 0;
    for (int k = 0; k < kMaxAdvances; ++k) {
      const ShapeDistance d = distance(t, target + tolerance + most * (until - t));
      if (t == 0 && d.value == 0) return {Impact::State::kOverlap, 0, Vec3::Zero()};
      if (d.value == 0) break;  // by rounding
      impact.normal = d.normal;
      const double speed = mu(d.normal);
      if (speed <= 0) return {};
      if (d.value <= target + tolerance) break;
      const double next = t + (d.value - target) / speed;
      if (next >= until) return {};
      if (next == t) break;
      t = next;
    }
    impact.state = Impact::State::kTouching;
    impact.time = t;
    return impact;
  }
};

struct ImpactOf {
  const Course &a, &b;
  double target, tolerance;

  template <class A, class B>
  Impact operator()(const A& shape_a, const B& shape_b) const {
    if constexpr (ConvexShape<A> && ConvexShape<B>) {
      const View<A> view_a(shape_a);
      const View<B> view_b(shape_b);
      return approach(view_a.convex, reach(view_b.convex, b)).advance(1, [&](double t, double far) {
        return convex_distance(view_a.convex, a.at(t), view_b.convex, b.at(t), far);
      });
    } else if constexpr (ConvexShape<A>) {
      if (b.travel != Vec3::Zero() || b.turn != Vec3::Zero()) {
        throw InputError("planes and meshes must not move");
      }
      const View<A> view(shape_a);
      return with_ground(view.convex, shape_b);
    } else if constexpr (ConvexShape<B>) {
      Impact flipped = ImpactOf{b, a, target, tolerance}(shape_b, shape_a);
      flipped.normal = -flipped.normal;
      return flipped;
    } else {
      throw InputError("planes and meshes do not meet each other");
    }
  }

  Impact with_ground(const Convex& shape, const Plane& plane) const {
    const Pose ground = b.at(0);
    return approach(shape, 0).advance(
        1, [&](double t, double) { return plane_distance(shape, a.at(t), plane, ground); });
  }

  Impact with_ground(const Convex& shape, const std::shared_ptr<const TriangleMesh>& mesh) const {
    const Pose ground = b.at(0);
    const Vec3 from = ground.to_local(a.body.position);
    const Vec3 to = ground.to_local(a.body.position + a.travel);
    const Vec3 centre = ground.to_local(a.at(0).position);
    const Vec3 room = Vec3::Constant(reach(shape, a) + shape.rounding + target + tolerance);
    const Approach approaching = approach(shape, 0);
    Impact first;
    mesh->for_each_in(from.cwiseMin(to) - room, from.cwiseMax(to) + room, [&](int triangle) {
      const TriangleView view(*mesh, triangle);
      if (mesh->normal(triangle).dot(centre - view.arrays.vertices[0]) < 0) return;  // behind
      const Impact impact = approaching.advance(first.time, [&](double t, double far) {
        return convex_distance(shape, a.at(t), view.convex, ground, far);
      });
      if (impact.state == Impact::State::kApart || first.state == Impact::State::kOverlap) return;
      if (impact.state == Impact::State::kOverlap || impact.time < first.time ||
          first.state == Impact::State::kApart) {
        first = impact;
      }
    });
    return first;
  }

  Approach approach(const Convex& shape, double reach_b) const {
    return {a, b, reach(shape, a), reach_b, target, tolerance};
  }
};

}  // namespace

Pose Course::at(double t) const {
  const Mat3 turned = rotation_by(t * turn).toRotationMatrix();
  return Pose(body.position + t * travel, Mat3(turned * body.rotation)) * local;
}

Impact time_of_impact(const Shape& a, const Course& course_a, const Shape& b,
                      const Course& course_b, double target, double tolerance) {
  return std::visit(ImpactOf{course_a, course_b, target, tolerance}, a, b);
}

}  // namespace substep::rigid
