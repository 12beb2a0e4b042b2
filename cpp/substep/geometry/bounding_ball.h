// Balls about shapes and obstacles: how far their surface reaches.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <variant>

#include "substep/geometry/collider.h"

namespace substep::geometry {

struct BoundingBall {
  Vec3 center = Vec3::Zero();                               // in the frame of the shape [m]
  double radius = std::numeric_limits<double>::infinity();  // [m]
};

// One with the surface of a shape in it: infinite about what has no end.
inline BoundingBall ball_around(const Shape& shape) {
  if (const auto* ball = std::get_if<Sphere>(&shape)) return {Vec3::Zero(), ball->radius};
  if (const auto* box = std::get_if<Box>(&shape)) return {Vec3::Zero(), box->half_lengths.norm()};
  if (const auto* capsule = std::get_if<Capsule>(&shape)) {
    return {Vec3::Zero(), capsule->half_length + capsule->radius};
  }
  if (const auto* cylinder = std::get_if<Cylinder>(&shape)) {
    return {Vec3::Zero(), std::hypot(cylinder->half_length, cylinder->radius)};
  }
  if (const auto* facet = std::get_if<Triangle>(&shape)) {
    const Vec3 middle = (facet->a + facet->b + facet->c) / 3;
    const double corner = std::max(
        {(facet->a - middle).norm(), (facet->b - middle).norm(), (facet->c - middle).norm()});
    return {middle, corner + facet->radius};
  }
  if (const auto* samples = std::get_if<std::shared_ptr<const SampledDistance>>(&shape)) {
    const auto& [nx, ny, nz] = (*samples)->shape();
    const Vec3 half =
        (*samples)->spacing() / 2 * Vec3(double(nx - 1), double(ny - 1), double(nz - 1));
    return {(*samples)->origin() + half, half.norm()};
  }
  return {};
}

// At all points x the signed distance of a collider is at least |x - center| - radius: infinite
// also about what is hollow, and distances that are not exact.
inline BoundingBall bounding_ball(const Collider& collider) {
  const bool sampled =
      std::holds_alternative<std::shared_ptr<const SampledDistance>>(collider.shape());
  return collider.hollow() || sampled ? BoundingBall() : ball_around(collider.shape());
}

}  // namespace substep::geometry
