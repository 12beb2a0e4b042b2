#include "substep/rigid/collision/convex_contacts.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/rigid/collision/face_patch.h"
#include "substep/rigid/collision/refine.h"
#include "substep/rigid/distance/epa.h"

namespace substep::rigid {
namespace {

constexpr double kPreference = 2e-2, kRounded = 1e-6;  // of the smaller shape's size
constexpr double kLevelLine = 1e-2;                    // [rad], how far from level a line may be
constexpr double kNone = -std::numeric_limits<double>::infinity();

void to_world(Manifold& manifold, const Pose& pose) {
  manifold.normal = pose.rotation * manifold.normal;
  for (int k = 0; k < manifold.count; ++k) {
    ContactPoint& point = manifold.points[k];
    point.on_a = pose.to_world(point.on_a);
    point.on_b = pose.to_world(point.on_b);
  }
}

// Whether the core turns a line to d.
bool is_line(const Convex& shape, const Vec3& d) {
  return shape.core != Convex::Core::polytope && shape.half_length > 0 &&
         std::abs(d.z()) < kLevelLine;
}

// The points along the best axis, or along a face that is nearly as good; in the frame of a.
void contact(const Difference& difference, const Axis& best, double margin, Manifold& manifold) {
  const Convex &a = difference.a, &b = difference.b;
  const double size = std::min(a.size, b.size), preference = face_preference(a, b);
  const Mat3& R = difference.pose_b.rotation;
  const FlatFace face_a = flat_face(a, best.normal);
  const FlatFace face_b = flat_face(b, -(R.transpose() * best.normal));
  const Vec3 normals[2] = {face_a.exists ? face_a.normal : best.normal,
                           face_b.exists ? Vec3(-(R * face_b.normal)) : best.normal};
  const double s[2] = {face_a.exists ? difference.separation(normals[0]) : kNone,
                       face_b.exists ? difference.separation(normals[1]) : kNone};
  const bool b_first = s[1] > s[0] + preference;
  for (const bool use_b : {b_first, !b_first}) {
    if (s[use_b] == kNone) continue;
    const double expected = expected_over_face(difference, best, normals[use_b], s[use_b]);
    if (expected > kNone &&
        face_patch(difference, normals[use_b], use_b, expected, margin, size, 0, manifold)) {
      return;
    }
  }
  if (is_line(a, best.normal) && is_line(b, R.transpose() * best.normal)) {
    // Lines along each other.
    const Vec3 n = Vec3(best.normal.x(), best.normal.y(), 0).normalized();
    if (face_patch(difference, n, false, best.separation + kPreference * size, margin, size, 0,
                   manifold)) {
      return;
    }
  }
  const Vec3& n = best.normal;
  manifold.normal = n;
  manifold.add({best.on_a + a.rounding * n, best.on_a + (best.separation - b.rounding) * n,
                best.separation - a.rounding - b.rounding, 1});
}

}  // namespace

Axis best_axis(const Difference& difference, double enough) {
  const Vec3& centre = difference.pose_b.position;
  const Distance gap = distance(difference, centre.isZero() ? Vec3(Vec3::UnitZ()) : centre, enough);
  if (gap.value > enough) return {gap.normal, gap.value, Vec3::Zero()};
  Axis axis{gap.normal, gap.value, gap.simplex.on_a()};
  if (!(gap.value > 0)) {
    const Penetration deep = penetration(difference, gap.simplex);
    axis = {deep.normal, deep.separation, deep.on_a};
  }
  return is_curved(difference) ? refine(difference, axis) : axis;
}

FlatFace flat_face(const Convex& shape, const Vec3& d) {
  if (shape.core == Convex::Core::polytope) {
    const Vec3& n = shape.polytope.planes[shape.polytope.facing(d)].normal;
    return {n.dot(d) > 0, n};
  }
  if (shape.core == Convex::Core::cylinder) {
    return {d.z() != 0, Vec3(0, 0, d.z() < 0 ? -1 : 1)};
  }
  if (shape.core == Convex::Core::other) {
    const Outline face = outline(shape, d);
    Vec3 area = Vec3::Zero();
    for (int k = 2; k < face.count; ++k)
      area += (face.corners[k - 1] - face.corners[0]).cross(face.corners[k] - face.corners[0]);
    return {face.count > 2, area.normalized()};
  }
  return {};
}

double face_preference(const Convex& a, const Convex& b) {
  return (a.rounding + b.rounding > 0 ? kRounded : kPreference) * std::min(a.size, b.size);
}

// Of a rounded shape, its core apart, whose normal is turned by an angle t from that of the face,
// the point at distance d is at the height d cos t, or, where that is beyond the face, t^2 d
// higher.
double expected_over_face(const Difference& difference, const Axis& best, const Vec3& n, double s) {
  const double preference = face_preference(difference.a, difference.b);
  const double rounding = difference.a.rounding + difference.b.rounding;
  if (s >= best.separation - preference) return s + 2 * preference;
  const bool along =
      rounding > 0 && best.separation > 0 && n.dot(best.normal) > 1 - 0.5 * kLevelLine * kLevelLine;
  return along ? best.separation + 2 * kLevelLine * kLevelLine * rounding : kNone;
}

void convex_convex(const Convex& a, const Pose& pose_a, const Convex& b, const Pose& pose_b,
                   double margin, Manifold& manifold, Cache& cache) {
  const Difference difference{a, b, pose_b.relative_to(pose_a)};
  const double enough = margin + a.rounding + b.rounding;
  // (Surely above, so that what follows would find the same.)
  if (!cache.axis.isZero() &&
      difference.separation(cache.axis) > enough + 1e-9 * difference.scale()) {
    return;
  }
  const Axis best = best_axis(difference, enough);
  if (!(best.separation <= enough)) {
    cache.axis = best.normal;
    return;
  }
  contact(difference, best, margin, manifold);
  to_world(manifold, pose_a);
}

void convex_plane(const Convex& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold) {
  const Pose pose = pose_b.relative_to(pose_a);
  const Vec3 n = pose.rotation * b.normal;
  const double offset = b.offset + n.dot(pose.position);
  const Outline low = outline(a, -n);
  const PlaneFrame frame(n * offset, n, std::abs(n.x()) < 0.7 ? Vec3::UnitX() : Vec3::UnitY());
  const Patch patch = frame.patch(low);
  const Reduced reduced = reduce(patch, margin + a.rounding, level(a) * a.size);
  manifold.normal = -n;
  for (int k = 0; k < reduced.count; ++k) {
    const PatchCorner& corner = patch.corners[reduced.index[k]];
    const Vec3 p = frame.point(corner);
    manifold.add({p - a.rounding * n, p - corner.height * n, corner.height - a.rounding,
                  corner_feature(corner, low.name)});
  }
  to_world(manifold, pose_a);
}

}  // namespace substep::rigid
