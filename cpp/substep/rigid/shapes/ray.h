// A ray, and the part of it that lies within a convex set.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

// origin + t direction for 0 <= t <= length
struct Ray {
  Vec3 origin, direction;  // direction: of length 1
  double length = std::numeric_limits<double>::infinity();

  Vec3 at(double t) const { return origin + t * direction; }
};

struct RayHit {
  double distance;  // t [m]
  Vec3 normal;      // of the surface, of length 1, against the ray
};

// The part of a ray's line within a convex set, made smaller set by set.
struct Passage {
  static constexpr double kEndless = std::numeric_limits<double>::infinity();
  double enter = -kEndless, leave = kEndless;
  Vec3 normal = Vec3::Zero();  // where it enters

  // By the half space normal . x <= offset.
  void cut(const Ray& ray, const Vec3& outward, double offset) {
    const double height = outward.dot(ray.origin) - offset, rate = outward.dot(ray.direction);
    if (rate < 0) {
      limit(height / -rate, outward);
    } else if (rate > 0) {
      leave = std::min(leave, height / -rate);
    } else if (height > 0) {
      leave = -kEndless;
    }
  }
  // By the cylinder of this radius about z, and by |z| <= half_length.
  void cut_sides(const Ray& ray, double radius);
  void cut_ends(const Ray& ray, double half_length) {
    cut(ray, Vec3::UnitZ(), half_length);
    cut(ray, -Vec3::UnitZ(), half_length);
  }
  void limit(double t, const Vec3& outward) {
    if (t > enter) enter = t, normal = outward;
  }
  std::optional<RayHit> hit(double length) const {
    if (!(enter >= 0 && enter <= leave && enter <= length)) return {};
    return RayHit{enter, normal};
  }
};

// Where the line o + t d is within r of 0; of two or three dimensions. The discriminant is made of
// the part of o across d, which does not cancel (Haines, Guenther, Akenine-Moeller, "Precision
// improvements for ray/sphere intersection", Ray Tracing Gems, 2019, ch. 7).
template <class V>
std::pair<double, double> within(const V& o, const V& d, double radius) {
  constexpr double kEndless = Passage::kEndless;
  const double square = d.squaredNorm();
  const double excess = o.squaredNorm() - radius * radius;
  if (!(square > 0)) {
    return excess > 0 ? std::pair(kEndless, -kEndless) : std::pair(-kEndless, kEndless);
  }
  const double middle = -o.dot(d) / square;
  const V across = o + middle * d;
  const double discriminant = radius * radius - across.squaredNorm();
  if (!(discriminant >= 0)) return {kEndless, -kEndless};
  // t^2 - 2 middle t + excess / square = 0: the root of larger size first, the other from it.
  const double half = std::sqrt(discriminant / square);
  const double large = middle < 0 ? middle - half : middle + half;
  const double small = large != 0 ? excess / square / large : 0;
  return middle < 0 ? std::pair(large, small) : std::pair(small, large);
}

inline void Passage::cut_sides(const Ray& ray, double radius) {
  const auto [first, last] =
      within(ray.origin.head<2>().eval(), ray.direction.head<2>().eval(), radius);
  const Vec3 at = ray.at(first);
  limit(first, Vec3(at.x(), at.y(), 0) / radius);
  leave = std::min(leave, last);
}

}  // namespace substep::rigid
