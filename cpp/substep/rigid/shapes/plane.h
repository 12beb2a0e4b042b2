// The half space normal . x <= offset, which is ground.
#pragma once

#include <limits>

#include "substep/core/errors.h"
#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

struct Plane {
  static constexpr const char* kName = "plane";
  Vec3 normal;  // of length 1
  double offset;

  template <class Numbers>
  static Plane with(const Numbers& of) {
    return {{of("normal_x"), of("normal_y"), of("normal_z")}, of("offset")};
  }
  void check(const Expect& expect) const {
    if (!(std::abs(normal.norm() - 1) < 1e-9))
      throw InputError(expect.where + "normal: expected a direction of length 1");
    if (!std::isfinite(offset)) throw InputError(expect.where + "offset: expected a finite number");
  }

  Bounds bounds(const Pose& pose) const {
    const Vec3 half = Vec3::Constant(std::numeric_limits<double>::infinity());
    return {pose.position - half, pose.position + half};
  }
  double outer_radius(const Pose&) const { return 0; }  // it never turns

  std::optional<RayHit> cast(const Ray& ray) const {
    Passage passage;
    passage.cut(ray, normal, offset);
    return passage.hit(ray.length);
  }
};

}  // namespace substep::rigid
