// What convex shapes turn to a direction.
#include <algorithm>
#include <array>
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
// place of a fixed one near it or between two; or the line on the side. What is tilted by more than
// kRolls rolls on its rim, where the lowest point should be alone.
Outline outline_of_cylinder(const Convex& c, const Vec3& d) {
  constexpr std::uint32_t kAround = 8;
  constexpr double kTilted = 1e-3, kRolls = 0.05;  // [rad]
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
  const double near = radial > kRolls * std::abs(d.z()) ? 0.35 : 0.1;  // [rad]
  out.name = d.z() < 0 ? 0 : 1;
  const auto add = [&](double x, double y, std::uint32_t name) {
    out.corners[out.count] = {x, y, z};
    out.names[out.count++] = name;
  };
  for (std::uint32_t k = 0; k < kAround; ++k) {
    const double angle = -pi + k * (2 * pi / kAround), next = angle + 2 * pi / kAround;
    const double past = lowest > pi - near ? lowest - 2 * pi : lowest;  // (-pi is a fixed one)
    const bool here = std::abs(past - angle) < near;
    if (!here) add(c.radius * std::cos(angle), c.radius * std::sin(angle), k);
    if (here || (angle < past - near && past + near < next)) {
      add(c.radius * (d.x() / radial), c.radius * (d.y() / radial), k);  // or on the edge k
    }
  }
  if (d.z() < 0) {  // counter-clockwise seen from outside
    std::reverse(out.corners, out.corners + out.count);
    std::reverse(out.names, out.names + out.count);
  }
  return out;
}

// By support points alone: those to d and to kAround directions about it are what lies on a flat
// face or along a line, and all as good as one point where the shape is curved. The convex polygon
// of those that are not close to a deeper one. The directions are fixed in the body, so that the
// points stay nearly the same while it rests.
Outline outline_by_support(const Convex& shape, const Vec3& d) {
  constexpr std::uint32_t kAround = 8;
  constexpr double kTilt = 1e-2;            // [rad]
  constexpr double kSamePoint = 3 * kTilt;  // of the extent
  constexpr double kStraight = 1e-6;        // [rad], of a corner that is none
  const PlaneFrame frame(Vec3::Zero(), d.normalized(),
                         std::abs(d.x()) < 0.7 * d.norm() ? Vec3::UnitX() : Vec3::UnitY());
  struct Point {
    Vec3 x;
    double u, v, height;
    std::uint32_t name;
  };
  std::array<Point, kAround + 1> points;
  for (std::uint32_t k = 0; k <= kAround; ++k) {
    const double angle = k * (2 * std::numbers::pi / kAround), tilt = k < kAround ? kTilt : 0;
    const Vec3 x =
        shape.support(frame.n + tilt * (std::cos(angle) * frame.u + std::sin(angle) * frame.v));
    points[k] = {x, frame.u.dot(x), frame.v.dot(x), frame.n.dot(x), k};
  }
  std::stable_sort(points.begin(), points.end(),
                   [](const Point& p, const Point& q) { return p.height > q.height; });
  std::size_t count = 0;
  for (const Point& p : points) {
    const auto same = [&](const Point& q) {
      return (p.x - q.x).norm() < kSamePoint * shape.extent;
    };
    if (std::none_of(points.begin(), points.begin() + count, same)) points[count++] = p;
  }
  // Andrew, "Another efficient algorithm for convex hulls in two dimensions", 1979: lower side,
  // then the upper one; counter-clockwise about d.
  std::sort(points.begin(), points.begin() + count,
            [](const Point& p, const Point& q) { return p.u != q.u ? p.u < q.u : p.v < q.v; });
  const auto turns_left = [](const Point& o, const Point& p, const Point& q) {
    const double a = p.u - o.u, b = p.v - o.v, c = q.u - o.u, e = q.v - o.v;
    return a * e - b * c > kStraight * std::hypot(a, b) * std::hypot(c, e);
  };
  std::array<Point, 2 * kAround + 3> ring;
  std::size_t n = 0;
  const auto take = [&](const Point& p, std::size_t first) {
    while (n >= first + 2 && !turns_left(ring[n - 2], ring[n - 1], p)) --n;
    ring[n++] = p;
  };
  for (std::size_t k = 0; k < count; ++k) take(points[k], 0);
  const std::size_t upper = n - 1;
  for (std::size_t k = count - 1; k-- > 0;) take(points[k], upper);
  Outline out;
  out.count = static_cast<int>(count == 1 ? 1 : n - 1);
  for (int k = 0; k < out.count; ++k) {
    out.corners[k] = ring[static_cast<std::size_t>(k)].x;
    out.names[k] = ring[static_cast<std::size_t>(k)].name;
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
    case Convex::Core::other:
      return outline_by_support(shape, d);
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
