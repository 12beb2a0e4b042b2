// The points within `radius` of the segment from (0, 0, -half_length) to (0, 0, half_length).
#pragma once

#include <numbers>

#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

struct Capsule {
  static constexpr const char* kName = "capsule";
  double radius, half_length;

  template <class Numbers>
  static Capsule with(const Numbers& of) {
    return {of("radius"), of("half_length")};
  }
  void check(const Expect& expect) const {
    expect.positive("radius", radius);
    expect.positive("half_length", half_length);
  }

  // Along the side: at one of its ends.
  Vec3 support(const Vec3& d) const {
    return d * (radius / d.norm()) + Vec3(0, 0, d.z() < 0 ? -half_length : half_length);
  }
  Bounds bounds(const Pose& pose) const {
    const Vec3 half = half_length * pose.rotation.col(2).cwiseAbs() + Vec3::Constant(radius);
    return {pose.position - half, pose.position + half};
  }
  Ball inner_ball() const { return {Vec3::Zero(), radius}; }
  double outer_radius(const Pose& local) const {
    const double low = local.to_world({0, 0, -half_length}).norm();
    return std::max(low, local.to_world({0, 0, half_length}).norm()) + radius;
  }

  // A cylinder and two half spheres, whose centres are 3 r / 8 beyond its ends.
  MassMoments moments(double density) const {
    const double pi = std::numbers::pi, r2 = radius * radius, h = half_length, h2 = h * h;
    const double tube = density * 2 * pi * r2 * h, caps = density * 4 / 3 * pi * r2 * radius;
    const double across = tube * (r2 / 4 + h2 / 3) + caps * (0.4 * r2 + h2 + 0.75 * h * radius);
    return MassMoments::centred(tube + caps, across, across, tube * r2 / 2 + caps * 0.4 * r2);
  }

  // The union of a cylinder and two balls; what enters it enters one of them from outside of all.
  std::optional<RayHit> cast(const Ray& ray) const {
    Passage first;
    first.cut_sides(ray, radius);
    first.cut_ends(ray, half_length);
    if (first.enter > first.leave) first.enter = Passage::kEndless;
    for (const double end : {-half_length, half_length}) {
      const Vec3 centre(0, 0, end);
      const auto [enter, leave] = within(Vec3(ray.origin - centre), ray.direction, radius);
      if (enter > leave) continue;
      if (enter < first.enter) {
        first.enter = enter;
        first.normal = (ray.at(enter) - centre) / radius;
      }
    }
    first.leave = Passage::kEndless;
    return first.enter < Passage::kEndless ? first.hit(ray.length) : std::nullopt;
  }

  Convex convex() const {
    return {.core = Convex::Core::segment,
            .half_length = half_length,
            .polytope = {},
            .rounding = radius,
            .size = radius,
            .extent = half_length};
  }
};

}  // namespace substep::rigid
