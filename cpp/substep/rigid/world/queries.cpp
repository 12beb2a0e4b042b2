#include "substep/rigid/world/queries.h"

#include <algorithm>
#include <cmath>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/distance/shape_distance.h"
#include "substep/rigid/distance/time_of_impact.h"

namespace substep::rigid {
namespace {

constexpr double kPrecision = 1e-7;  // of the half lengths of a shape that is cast
constexpr std::int64_t kRaysPerChunk = 64;

bool nearer(const FixtureHit& p, const FixtureHit& q) {
  return p.distance != q.distance ? p.distance < q.distance : p.fixture < q.fixture;
}

void check(const Vec3& origin, const Vec3& direction, double length) {
  if (!origin.allFinite() || !(std::abs(direction.norm() - 1) < 1e-6)) {
    throw InputError("a way needs a finite origin and a direction of length 1");
  }
  if (!(length >= 0)) throw InputError("the length of a way must not be negative");
}

// Calls meet(fixture, length) for what may be met, which returns a hit or none; the way ends at the
// nearest one.
template <class Meet>
std::optional<FixtureHit> first_met(const Scene& scene, const Vec3& origin, const Vec3& direction,
                                    double length, const Vec3& half_lengths, std::uint32_t mask,
                                    Meet&& meet) {
  std::optional<FixtureHit> first;
  scene.broad_phase.cast(origin, direction, length, half_lengths, [&](std::int32_t fixture) {
    const PlacedShape placed = scene.fixture(fixture);
    if ((placed.group & mask) == 0) return length;
    std::optional<FixtureHit> hit = meet(placed, length);
    if (hit) {
      hit->fixture = fixture;
      if (!first || nearer(*hit, *first)) first = hit;
      length = first->distance;
    }
    return length;
  });
  return first;
}

std::optional<FixtureHit> meet_ray(const PlacedShape& placed, const Ray& ray) {
  const auto hit = ray_cast(*placed.shape, placed.pose, ray);
  if (!hit) return {};
  return FixtureHit{-1, hit->distance, hit->normal};
}

}  // namespace

std::optional<FixtureHit> cast_ray(const Scene& scene, const Ray& ray, std::uint32_t mask) {
  check(ray.origin, ray.direction, ray.length);
  return first_met(scene, ray.origin, ray.direction, ray.length, Vec3::Zero(), mask,
                   [&](const PlacedShape& placed, double length) {
                     return meet_ray(placed, {ray.origin, ray.direction, length});
                   });
}

std::vector<FixtureHit> cast_ray_through(const Scene& scene, const Ray& ray, std::uint32_t mask) {
  check(ray.origin, ray.direction, ray.length);
  std::vector<FixtureHit> hits;
  const auto take = [&](std::int32_t fixture) {
    const PlacedShape placed = scene.fixture(fixture);
    if ((placed.group & mask) != 0) {
      if (auto hit = meet_ray(placed, ray)) {
        hit->fixture = fixture;
        hits.push_back(*hit);
      }
    }
    return ray.length;
  };
  scene.broad_phase.cast(ray.origin, ray.direction, ray.length, Vec3::Zero(), take);
  std::sort(hits.begin(), hits.end(), nearer);
  return hits;
}

void cast_rays(const Scene& scene, std::span<const Ray> rays, std::uint32_t mask,
               std::span<FixtureHit> hits, int threads) {
  if (hits.size() != rays.size()) throw InputError("there must be as many hits as rays");
  for (const Ray& ray : rays) check(ray.origin, ray.direction, ray.length);
  parallel_for(
      static_cast<std::int64_t>(rays.size()), kRaysPerChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (auto k = usize(begin); k < usize(end); ++k) {
          hits[k] = cast_ray(scene, rays[k], mask).value_or(FixtureHit{});
        }
      },
      threads);
}

std::optional<FixtureHit> cast_shape(const Scene& scene, const Shape& shape, const Pose& pose,
                                     const Vec3& direction, double length, std::uint32_t mask) {
  check(pose.position, direction, length);
  if (!std::isfinite(length) || is_ground(shape)) {
    throw InputError("a convex shape is cast along a finite way");
  }
  const Bounds box = bounds(shape, pose);
  const Vec3 half = (box.high - box.low) / 2;
  Course course;
  course.body = pose;
  course.travel = length * direction;  // always the whole way, so that no hit depends on another
  return first_met(scene, (box.low + box.high) / 2, direction, length, half, mask,
                   [&](const PlacedShape& placed, double) -> std::optional<FixtureHit> {
                     Course still;
                     still.body = placed.pose;
                     const Impact impact = time_of_impact(shape, course, *placed.shape, still, 0,
                                                          kPrecision * half.minCoeff());
                     if (impact.state == Impact::State::kApart) return {};
                     return FixtureHit{-1, impact.time * length, -impact.normal};
                   });
}

std::vector<std::int32_t> overlapping(const Scene& scene, const Shape& shape, const Pose& pose,
                                      std::uint32_t mask) {
  if (is_ground(shape)) throw InputError("the shape must be convex");
  std::vector<std::int32_t> found = scene.broad_phase.overlapping(bounds(shape, pose));
  std::erase_if(found, [&](std::int32_t fixture) {
    const PlacedShape placed = scene.fixture(fixture);
    return (placed.group & mask) == 0 ||
           shape_distance(shape, pose, *placed.shape, placed.pose, 0).value > 0;
  });
  return found;
}

}  // namespace substep::rigid
