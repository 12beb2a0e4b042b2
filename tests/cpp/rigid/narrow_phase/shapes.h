// Shapes, poses and the definition of separation for the tests of the narrow phase.
#pragma once

#include <algorithm>
#include <limits>
#include <numbers>
#include <random>
#include <utility>
#include <vector>

#include "substep/rigid/collision/narrow_phase.h"

namespace substep::rigid {

inline constexpr double kQuarter = std::numbers::pi / 2;  // of a turn

using Random = std::mt19937_64;

inline double uniform(Random& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1p-53;
}
inline Vec3 direction(Random& random) {
  while (true) {
    const double x = uniform(random, -1, 1), y = uniform(random, -1, 1);
    const Vec3 d(x, y, uniform(random, -1, 1));
    if (d.squaredNorm() < 1 && d.squaredNorm() > 0.01) return d.normalized();
  }
}
inline Quaternion rotation(Random& random) {
  const double angle = uniform(random, 0, 3.1);
  return Quaternion(Eigen::AngleAxisd(angle, direction(random)));
}

inline Vec3 support_of(const Shape& shape, const Vec3& d) {
  return std::visit(
      [&](const auto& s) -> Vec3 {
        if constexpr (ConvexShape<decltype(s)>) {
          return shape_of(s).support(d);
        } else {
          return Vec3::Zero();
        }
      },
      shape);
}

// s(n) by the definition.
inline double separation(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                         const Vec3& n) {
  const Vec3 x = pose_a.to_world(support_of(a, pose_a.rotation.transpose() * n));
  const Vec3 y = pose_b.to_world(support_of(b, -(pose_b.rotation.transpose() * n)));
  return n.dot(y - x);
}

inline double deepest(const Manifold& manifold) {
  double least = std::numeric_limits<double>::infinity();
  for (int k = 0; k < manifold.count; ++k) {
    least = std::min(least, manifold.points[k].separation);
  }
  return least;
}

inline std::shared_ptr<const ConvexHull> random_hull(Random& random, int points) {
  std::vector<Vec3> p(points);
  for (Vec3& x : p) x = 0.5 * direction(random).cwiseProduct(Vec3(1.2, 1, 0.7));
  return std::make_shared<const ConvexHull>(p);
}

inline std::vector<std::pair<const char*, Shape>> shapes(Random& random) {
  return {{"sphere", Sphere{0.45}},
          {"capsule", Capsule{0.3, 0.4}},
          {"box", Box{{0.5, 0.3, 0.4}}},
          {"cylinder", Cylinder{0.4, 0.35}},
          {"tetrahedron", random_hull(random, 4)},
          {"hull", random_hull(random, 30)}};
}

// A random pose of b at which planes across a random direction part a and b by `gap`.
inline Pose placed_at_distance(const Shape& a, const Pose& pose_a, const Shape& b, double gap,
                               Random& random) {
  Pose pose_b(pose_a.position, rotation(random));
  const Vec3 d = direction(random);
  pose_b.position += (gap - separation(a, pose_a, b, pose_b, d)) * d;
  return pose_b;
}

}  // namespace substep::rigid
