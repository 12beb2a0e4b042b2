// What convex shapes turn to a direction.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "substep/rigid/collision/face_patch.h"

namespace substep::rigid {
namespace {

Outline outline_of(const Polytope& p, const Vec3& d) {
  Outline out;
  const int face = p.facing(d);
  const int first = p.first_corner[face], n = p.first_corner[face + 1] - first;
  out.name = static_cast<std::uint32_t>(face);
  out.count = std::min(n, kMaxCorners);  // of more, every so many
  for (int k = 0; k < out.count; ++k) {
    const std::int32_t v = p.corners[first + static_cast<std::int64_t>(k) * n / out.count];
    out.corners[k] = p.vertices[v];
    out.names[k] = static_cast<std::uint32_t>(k);
  }
  return out;
}

// A cap as the polygon of kAround points that are fixed in the body, so that they stay the same
// while it rests, and, where it is tilted by more than kTilted, the lowest point of the rim in
// place of a fixed one within kNear or between two; or the line on the side.
Outline outline_of_cylinder(const Convex& c, const Vec3& d) {
  constexpr std::uint32_t kAround = 8;
  constexpr double kTilted = 1e-3, kNear = 0.1;  // [rad]
  const double radial = std::hypot(d.x(), d.y());
  Outline out;
  if (std::abs(d.z()) < radial) {
    const Vec3 side(c.radius * d.x() / radial, c.radius * d.y() / radial, 0);
    out.count = 2;
    out.name = 2;
    for (const std::uint32_t k : {0u, 1u}) {
      out.corners[k] = side + Vec3(0, 0, k == 0 ? -c.half_length : c.half_length);
      out.names[k] = k;
    }
    return out;
  }
  const double z = d.z() < 0 ? -c.half_length : c.half_length, pi = std::numbers::pi;
  const double lowest = radial > kTilted * std::abs(d.z()) ? std::atan2(d.y(), d.x()) : -1e9;
  out.name = d.z() < 0 ? 0 : 1;
  const auto add = [&](double x, double y, std::uint32_t name) {
    out.corners[out.count] = {x, y, z};
    out.names[out.count++] = name;
  };
  for (std::uint32_t k = 0; k < kAround; ++k) {
    const double angle = -pi + k * (2 * pi / kAround), next = angle + 2 * pi / kAround;
    const double past = lowest > pi - kNear ? lowest - 2 * pi : lowest;  // (-pi is a fixed one)
    const bool here = std::abs(past - angle) < kNear;
    if (!here) add(c.radius * std::cos(angle), c.radius * std::sin(angle), k);
    if (here || (angle < past - kNear && past + kNear < next)) {
      add(c.radius * (d.x() / radial), c.radius * (d.y() / radial), k);  // or on the edge k
    }
  }
  if (d.z() < 0) {  // counter-clockwise seen from outside
    std::reverse(out.corners, out.corners + out.count);
    std::reverse(out.names, out.names + out.count);
  }
  return out;
}

}  // namespace

Outline outline(const Convex& shape, const Vec3& d) {
  switch (shape.core) {
    case Convex::Core::polytope:
      return outline_of(shape.polytope, d);
    case Convex::Core::cylinder:
      return outline_of_cylinder(shape, d);
    case Convex::Core::segment:
      break;
  }
  Outline out;
  out.count = shape.half_length > 0 ? 2 : 1;
  for (std::uint32_t k = 0; k < static_cast<std::uint32_t>(out.count); ++k) {
    out.corners[k] = {0, 0, k == 0 ? -shape.half_length : shape.half_length};
    out.names[k] = k;
  }
  return out;
}

}  // namespace substep::rigid
