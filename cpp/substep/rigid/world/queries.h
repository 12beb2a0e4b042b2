// Questions about a scene: what a ray or a moving shape meets, what a shape overlaps with.
//
// The answers depend on the shapes and the numbers of the fixtures alone: what is equally near
// comes in the order of the numbers. Fixtures count where they were at the last
// BroadPhase::update().
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "substep/rigid/distance/ray_cast.h"

namespace substep::rigid {

class BroadPhase;

struct PlacedShape {
  const Shape* shape;
  Pose pose;  // in the world
  std::uint32_t group = 1;
};

struct Scene {
  const BroadPhase& broad_phase;
  std::function<PlacedShape(std::int32_t fixture)> fixture;
};

struct FixtureHit {
  std::int32_t fixture = -1;  // -1: none
  double distance = 0;        // [m] along the way
  // Of a ray, of the surface that it meets; of a shape, from what it meets towards it, 0 where they
  // overlap at the beginning.
  Vec3 normal = Vec3::Zero();
};

// Only fixtures of a group in `mask` count, here and below. See ray_cast.h for what a ray meets.
std::optional<FixtureHit> cast_ray(const Scene& scene, const Ray& ray, std::uint32_t mask = ~0u);
// All fixtures that it meets, with the first point of each, from near to far.
std::vector<FixtureHit> cast_ray_through(const Scene& scene, const Ray& ray,
                                         std::uint32_t mask = ~0u);
// The same for many rays at once: hits[k] of rays[k].
void cast_rays(const Scene& scene, std::span<const Ray> rays, std::uint32_t mask,
               std::span<FixtureHit> hits, int threads = 0);

// What a convex shape meets first on its way, which is finite, without turning; up to 1e-7 of its
// size. What it overlaps with at the beginning is met at 0.
std::optional<FixtureHit> cast_shape(const Scene& scene, const Shape& shape, const Pose& pose,
                                     const Vec3& direction, double length,
                                     std::uint32_t mask = ~0u);

// The fixtures that a convex shape overlaps with or touches, in ascending order.
std::vector<std::int32_t> overlapping(const Scene& scene, const Shape& shape, const Pose& pose,
                                      std::uint32_t mask = ~0u);

}  // namespace substep::rigid
