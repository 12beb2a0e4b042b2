#include "substep/rigid/collision/refine.h"

#include <algorithm>
#include <cmath>
#include <span>

namespace substep::rigid {
namespace {

// [rad], how far from level what lies along the contact may be: an edge, the side of a cylinder or
// an axis.
constexpr double kLevel = 1e-4, kSide = 1e-2;
constexpr double kFar = 1e-2;        // [rad], of a step that is no correction any more
constexpr double kRounding = 1e-15;  // of the scale
constexpr int kIterations = 6;

// What a core turns to d (of length 1), to second order, in the frame of the core.
struct Tip {
  Vec3 point;
  int lines = 0;               // 0: a point; 1: an edge or a side; 2: a face
  Vec3 along = Vec3::Zero();   // of one line
  Mat3 second = Mat3::Zero();  // d2 (support function) / dd2
};

Tip tip_of_polytope(const Polytope& p, const Vec3& d) {
  const int best = p.support_vertex(d);
  Tip tip{p.vertices[best]};
  for (int k = 0; k < static_cast<int>(p.vertices.size()); ++k) {
    const Vec3 e = p.vertices[k] - tip.point;
    if (k == best || d.dot(e) < -kLevel * e.norm()) continue;
    const bool other = tip.lines > 0 && e.cross(tip.along).norm() > kLevel * e.norm();
    tip.lines = other ? 2 : std::max(tip.lines, 1);
    if (tip.lines == 1) tip.along = e.normalized();
  }
  return tip;
}

Tip tip_of_cylinder(const Convex& c, const Vec3& d) {
  const double radial = std::hypot(d.x(), d.y());
  Tip tip{c.support(d)};
  if (radial < kLevel) {
    tip.lines = 2;
    return tip;
  }
  const Vec3 tangent(-d.y() / radial, d.x() / radial, 0);
  tip.second = c.radius / radial * (tangent * tangent.transpose());
  if (std::abs(d.z()) < kSide) tip.lines = 1, tip.along = Vec3::UnitZ();
  return tip;
}

Tip tip_of(const Convex& shape, const Vec3& d) {
  if (shape.core == Convex::Core::polytope) return tip_of_polytope(shape.polytope, d);
  if (shape.core == Convex::Core::cylinder) return tip_of_cylinder(shape, d);
  if (shape.core == Convex::Core::other) return {shape.support(d), 2};  // not known: as it is
  Tip tip{shape.support(d)};
  if (shape.half_length > 0 && std::abs(d.z()) < kSide) tip.lines = 1, tip.along = Vec3::UnitZ();
  return tip;
}

// One of the two sides of a contact at the normal n, in the frame of a.
Tip tip_a(const Difference& d, const Vec3& n) { return tip_of(d.a, n); }
Tip tip_b(const Difference& d, const Vec3& n) {
  const Pose& pose = d.pose_b;
  Tip tip = tip_of(d.b, -(pose.rotation.transpose() * n));
  tip.point = pose.to_world(tip.point);
  tip.along = pose.rotation * tip.along;
  tip.second = pose.rotation * tip.second * pose.rotation.transpose();
  return tip;
}

// The normal across `lines` at which s is stationary, from n on.
Vec3 stationary(const Difference& difference, Vec3 n, std::span<const Vec3> lines) {
  Mat3 across = Mat3::Identity();
  for (const Vec3& line : lines) {
    const Vec3 e = across * line;
    if (e.norm() > kLevel) across -= e * e.transpose() / e.squaredNorm();
  }
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    n = (across * n).normalized();
    const Tip a = tip_a(difference, n), b = tip_b(difference, n);
    // On the directions that are free, as a 3x3 system that leaves all others alone.
    const Mat3 free = across - n * n.transpose();
    const Vec3 w = b.point - a.point, gradient = free * w;
    const double s = n.dot(w);
    const Mat3 hessian = -free * (a.second + b.second) * free - s * free;
    const Mat3 fixed = Mat3::Identity() - free;
    const Vec3 step = (fixed - hessian).ldlt().solve(gradient);
    if (!(step.norm() < kFar)) break;  // as good in all directions: coaxial cylinders
    n += step;
    if (step.squaredNorm() < 1e-28) break;
  }
  return (across * n).normalized();
}

// The point of a where the two meet along n.
Vec3 meeting_point(const Tip& a, const Tip& b, const Vec3& n, const Vec3& otherwise) {
  const Vec3 w = b.point - a.point;
  if (a.lines == 0) return a.point;
  if (b.lines == 0) return b.point - n.dot(w) * n;
  const double crossing = n.dot(a.along.cross(b.along));
  if (std::abs(crossing) < kLevel) return otherwise;
  return a.point + n.dot(w.cross(b.along)) / crossing * a.along;
}

}  // namespace

Axis refine(const Difference& difference, const Axis& axis) {
  const Tip a = tip_a(difference, axis.normal), b = tip_b(difference, axis.normal);
  if (a.lines == 2 || b.lines == 2) return axis;  // a face, whose normal is known
  const double before = difference.separation(axis.normal);
  // Whether a line lies along the contact or only its end takes part shows in s.
  const Vec3 lines[2] = {a.along, b.along};
  for (const bool along_a : {a.lines == 1, false}) {
    for (const bool along_b : {b.lines == 1, false}) {
      const Vec3 n = stationary(difference, axis.normal,
                                std::span(lines).subspan(along_a ? 0 : 1, along_a + along_b));
      const double s = difference.separation(n);
      if (!(s >= before - kRounding * difference.scale())) continue;
      Tip tip_at_a = tip_a(difference, n), tip_at_b = tip_b(difference, n);
      tip_at_a.lines = along_a, tip_at_b.lines = along_b;
      return {n, s, meeting_point(tip_at_a, tip_at_b, n, axis.on_a)};
    }
  }
  return axis;
}

}  // namespace substep::rigid
