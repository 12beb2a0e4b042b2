// A box about the origin.
#pragma once

#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

struct Box {
  static constexpr const char* kName = "box";
  Vec3 half_lengths;

  template <class Numbers>
  static Box with(const Numbers& of) {
    return {{of("half_x"), of("half_y"), of("half_z")}};
  }
  void check(const Expect& expect) const {
    for (const double half : half_lengths) expect.positive("half_lengths", half);
  }

  // Always a corner.
  Vec3 support(const Vec3& d) const {
    const auto sign = [](double a, double h) { return a < 0 ? -h : h; };
    return {sign(d.x(), half_lengths.x()), sign(d.y(), half_lengths.y()),
            sign(d.z(), half_lengths.z())};
  }
  Bounds bounds(const Pose& pose) const {
    const Vec3 half = pose.rotation.cwiseAbs() * half_lengths;
    return {pose.position - half, pose.position + half};
  }
  Ball inner_ball() const { return {Vec3::Zero(), half_lengths.minCoeff()}; }
  double outer_radius(const Pose& local) const {
    double most = 0;
    for (int k = 0; k < 8; ++k) {
      const Vec3& h = half_lengths;
      const Vec3 corner((k & 1 ? 1 : -1) * h.x(), (k & 2 ? 1 : -1) * h.y(),
                        (k & 4 ? 1 : -1) * h.z());
      most = std::max(most, local.to_world(corner).norm());
    }
    return most;
  }

  MassMoments moments(double density) const {
    const Vec3 h2 = half_lengths.cwiseAbs2();
    const double mass = density * 8 * half_lengths.prod();
    return MassMoments::centred(mass, mass / 3 * (h2.y() + h2.z()), mass / 3 * (h2.x() + h2.z()),
                                mass / 3 * (h2.x() + h2.y()));
  }

  std::optional<RayHit> cast(const Ray& ray) const {
    Passage passage;
    for (int i = 0; i < 3; ++i) {
      passage.cut(ray, Vec3::Unit(i), half_lengths[i]);
      passage.cut(ray, -Vec3::Unit(i), half_lengths[i]);
    }
    return passage.hit(ray.length);
  }
};

// The arrays of the box must live as long.
inline Convex convex(const Box& box, const BoxPolytope& arrays) {
  return {.core = Convex::Core::polytope,
          .polytope = arrays.polytope(),
          .size = box.half_lengths.minCoeff(),
          .extent = box.half_lengths.norm()};
}

}  // namespace substep::rigid
