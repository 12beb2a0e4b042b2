// A cylinder about z, from -half_length to half_length.
#pragma once

#include <cmath>
#include <numbers>

#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

struct Cylinder {
  static constexpr const char* kName = "cylinder";
  double radius, half_length;

  template <class Numbers>
  static Cylinder with(const Numbers& of) {
    return {of("radius"), of("half_length")};
  }
  void check(const Expect& expect) const {
    expect.positive("radius", radius);
    expect.positive("half_length", half_length);
  }

  // Along the side: at one of its ends.
  Vec3 support(const Vec3& d) const {
    const double radial = std::hypot(d.x(), d.y()), scale = radial > 0 ? radius / radial : 0;
    return {scale * d.x(), scale * d.y(), d.z() < 0 ? -half_length : half_length};
  }
  // The disc reaches r sqrt(1 - u_i^2) along the axis i, u being its normal.
  Bounds bounds(const Pose& pose) const {
    const Vec3 u = pose.rotation.col(2).cwiseAbs();
    const Vec3 half = half_length * u + radius * pose.rotation.leftCols<2>().rowwise().norm();
    return {pose.position - half, pose.position + half};
  }
  Ball inner_ball() const { return {Vec3::Zero(), std::min(radius, half_length)}; }
  double outer_radius(const Pose& local) const {
    const Vec3 centre = local.rotation.transpose() * local.position;
    return std::hypot(std::hypot(centre.x(), centre.y()) + radius,
                      std::abs(centre.z()) + half_length);
  }

  MassMoments moments(double density) const {
    const double r2 = radius * radius, h2 = half_length * half_length;
    const double mass = density * 2 * std::numbers::pi * r2 * half_length;
    const double across = mass * (r2 / 4 + h2 / 3);
    return MassMoments::centred(mass, across, across, mass * r2 / 2);
  }

  std::optional<RayHit> cast(const Ray& ray) const {
    Passage passage;
    passage.cut_sides(ray, radius);
    passage.cut_ends(ray, half_length);
    return passage.hit(ray.length);
  }

  Convex convex() const {
    return {.core = Convex::Core::cylinder,
            .radius = radius,
            .half_length = half_length,
            .polytope = {},
            .size = std::min(radius, half_length),
            .extent = std::hypot(radius, half_length)};
  }
};

}  // namespace substep::rigid
