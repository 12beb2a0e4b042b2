// A ball about the origin.
#pragma once

#include <numbers>
#include <tuple>

#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

struct Sphere {
  static constexpr const char* kName = "sphere";
  double radius;

  template <class Numbers>
  static Sphere with(const Numbers& of) {
    return {of("radius")};
  }
  void check(const Expect& expect) const { expect.positive("radius", radius); }

  Vec3 support(const Vec3& d) const { return d * (radius / d.norm()); }
  Bounds bounds(const Pose& pose) const {
    const Vec3 half = Vec3::Constant(radius);
    return {pose.position - half, pose.position + half};
  }
  Ball inner_ball() const { return {Vec3::Zero(), radius}; }
  double outer_radius(const Pose& local) const { return local.position.norm() + radius; }

  MassMoments moments(double density) const {
    const double r2 = radius * radius, mass = density * 4 / 3 * std::numbers::pi * r2 * radius;
    const double I = 0.4 * mass * r2;
    return MassMoments::centred(mass, I, I, I);
  }

  std::optional<RayHit> cast(const Ray& ray) const {
    Passage passage;
    std::tie(passage.enter, passage.leave) = within(ray.origin, ray.direction, radius);
    passage.normal = ray.at(passage.enter) / radius;
    return passage.hit(ray.length);
  }

  Convex convex() const {
    return {.core = Convex::Core::segment,
            .polytope = {},
            .rounding = radius,
            .size = radius,
            .extent = 0};
  }
};

}  // namespace substep::rigid
