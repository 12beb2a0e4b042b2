#include "substep/rigid/distance/ray_cast.h"

#include <limits>

#include "substep/rigid/distance/gjk.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {

std::optional<RayHit> cast_by_support(const Convex& shape, const Ray& ray) {
  constexpr int kMaxPlanes = 200;
  constexpr double kOnSurface = 1e-10;  // of the size
  const Convex point{
      .core = Convex::Core::segment, .polytope = {}, .size = 0, .extent = 0};  // of no length
  RayHit hit{0, Vec3::Zero()};
  for (int k = 0; k < kMaxPlanes; ++k) {
    const Vec3 at = ray.at(hit.distance);
    const Distance gap = distance(Difference{shape, point, Pose(at, Mat3::Identity())},
                                  at - shape.centre, std::numeric_limits<double>::infinity());
    if (!(gap.value > 0)) break;
    // What is left above the plane that touches the shape with this normal.
    const double height = gap.normal.dot(at - shape.support(gap.normal)) - shape.rounding;
    if (!(height > kOnSurface * shape.size)) break;
    const double rate = gap.normal.dot(ray.direction);
    if (!(rate < 0)) return {};
    hit = {hit.distance + height / -rate, gap.normal};
    if (!(hit.distance <= ray.length)) return {};
  }
  if (hit.normal.isZero(0)) return {};  // it begins within
  return hit;
}

std::optional<RayHit> ray_cast(const Shape& shape, const Pose& pose, const Ray& ray) {
  const Ray local{pose.to_local(ray.origin), pose.rotation.transpose() * ray.direction, ray.length};
  const auto cast = [&](const auto& s) {
    if constexpr (requires { shape_of(s).cast(local); }) {
      return shape_of(s).cast(local);
    } else {
      return cast_by_support(View(s).convex, local);
    }
  };
  auto hit = std::visit(cast, shape);
  if (hit) hit->normal = pose.rotation * hit->normal;
  return hit;
}

}  // namespace substep::rigid
