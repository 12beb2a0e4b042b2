#include "substep/rigid/convex_contacts.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "substep/rigid/epa.h"

namespace substep::rigid {
namespace {

// Fractions of the smaller shape's size (see box_box.cpp): what a side lets pass; by how much less
// than the best axis may a face separate and still be taken, for sharp shapes and for rounded ones,
// whose normal turns at an edge; how far aside of a line another one is still along it.
constexpr double kSlack = 1e-4, kPreference = 1e-3, kRounded = 1e-6, kAside = 1e-2, kTie = 1e-5;

struct Face {
  bool exists = false;
  Vec3 normal;
};

// The flat face that the core turns to d.
Face face(const Convex& shape, const Vec3& d) {
  if (shape.core == Convex::Core::polytope) {
    const Vec3& n = shape.polytope.planes[shape.polytope.facing(d)].normal;
    return {n.dot(d) > 0, n};
  }
  if (shape.core == Convex::Core::cylinder) {
    return {d.z() != 0, Vec3(0, 0, d.z() < 0 ? -1 : 1)};
  }
  return {};
}

// Contact of the outline of one core (the reference, outward normal n) with the other's: all in the
// frame of a, separations of the cores less `rounding`.
struct Frame {
  Frame(const Vec3& origin, const Vec3& normal, const Vec3& along)
      : o(origin), n(normal), u((along - n.dot(along) * n).normalized()), v(n.cross(u)) {}
  PatchCorner corner(const Vec3& p, std::uint32_t before, std::uint32_t after) const {
    const Vec3 d = p - o;
    return {u.dot(d), v.dot(d), n.dot(d), before, after};
  }
  Vec3 point(const PatchCorner& c) const { return o + c.u * u + c.v * v + c.height * n; }

  Vec3 o, n, u, v;
};

struct Contact {
  const Difference& difference;
  const Pose& pose_a;
  double margin, rounding;
  Manifold& manifold;

  Outline outline_a(const Vec3& d) const { return outline(difference.a, d); }
  Outline outline_b(const Vec3& d) const {
    const Pose& pose = difference.pose_b;
    Outline out = outline(difference.b, pose.rotation.transpose() * d);
    for (int k = 0; k < out.count; ++k) out.corners[k] = pose.to_world(out.corners[k]);
    return out;
  }

  // x_a, x_b: on the cores, in the frame of a; n from a to b.
  void add(const Vec3& n, const Vec3& x_a, const Vec3& x_b, double separation,
           std::uint32_t feature) const {
    const Vec3 on_a = x_a + difference.a.rounding * n, on_b = x_b - difference.b.rounding * n;
    manifold.add({pose_a.to_world(on_a), pose_a.to_world(on_b), separation - rounding, feature});
  }

  // Clips the outline of one shape by the sides of the other's: false where nothing is left of it
  // that is as low as `expected`.
  bool clip_outlines(const Vec3& n, bool b_is_reference, double expected, double size) const {
    const Outline reference = b_is_reference ? outline_b(-n) : outline_a(n);
    const Outline incident = b_is_reference ? outline_a(n) : outline_b(-n);
    const Frame frame(reference.corners[0], b_is_reference ? Vec3(-n) : n,
                      reference.corners[1] - reference.corners[0]);
    Patch patch;
    patch.count = incident.count;
    for (int k = 0; k < incident.count; ++k) {
      const int before = incident.count == 2 ? k : (k == 0 ? incident.count : k) - 1;
      patch.corners[k] =
          frame.corner(incident.corners[k], incident.names[before], incident.names[k]);
    }
    const double slack = kSlack * size;
    if (reference.count == 2) {  // a line: what is along it, between its ends
      for (int k = 0; k < patch.count; ++k) {
        if (std::abs(patch.corners[k].v) > kAside * size) return false;
      }
      const double length = (reference.corners[1] - reference.corners[0]).norm();
      clip(patch, {1, 0, length, 64}, slack);
      clip(patch, {-1, 0, 0, 65}, slack);
    } else {
      for (int k = 0; k < reference.count; ++k) {
        const Vec3 &p = reference.corners[k],
                   &q = reference.corners[k + 1 == reference.count ? 0 : k + 1];
        const PatchCorner s = frame.corner(p, 0, 0), e = frame.corner(q, 0, 0);
        const double d_u = e.u - s.u, d_v = e.v - s.v, length = std::hypot(d_u, d_v);
        const double n_u = d_v / length, n_v = -d_u / length;
        clip(patch, {n_u, n_v, n_u * s.u + n_v * s.v, 64 + reference.names[k]}, slack);
      }
    }
    double lowest = std::numeric_limits<double>::infinity();
    for (int k = 0; k < patch.count; ++k) lowest = std::min(lowest, patch.corners[k].height);
    if (lowest > expected) return false;
    manifold.normal = pose_a.rotation * n;
    const Reduced reduced = reduce(patch, margin + rounding, kTie * size);
    const std::uint32_t faces = reference.name * 65599u + incident.name * 2 + b_is_reference;
    for (int k = 0; k < reduced.count; ++k) {
      const PatchCorner& corner = patch.corners[reduced.index[k]];
      const Vec3 p = frame.point(corner), foot = p - corner.height * frame.n;
      add(n, b_is_reference ? p : foot, b_is_reference ? foot : p, corner.height,
          corner_feature(corner, faces));
    }
    return true;
  }
};

}  // namespace

void convex_convex(const Convex& a, const Pose& pose_a, const Convex& b, const Pose& pose_b,
                   double margin, Manifold& manifold, Cache& cache) {
  const Difference difference{a, b, pose_b.relative_to(pose_a)};
  const double rounding = a.rounding + b.rounding, enough = margin + rounding;
  // (Surely above, so that rounding cannot make a difference to what follows without a cache.)
  if (!cache.axis.isZero() &&
      difference.separation(cache.axis) > enough + 1e-9 * difference.scale()) {
    return;
  }
  const Vec3& centre = difference.pose_b.position;
  const Distance gap = distance(difference, centre.isZero() ? Vec3(Vec3::UnitZ()) : centre, enough);
  if (gap.value > enough) {
    cache.axis = gap.normal;
    return;
  }
  Penetration best{gap.normal, gap.value, gap.simplex.on_a()};
  if (!(gap.value > 0)) best = penetration(difference, gap.simplex);
  if (!(best.separation <= enough)) return;

  const Contact contact{difference, pose_a, margin, rounding, manifold};
  const double size = std::min(a.size, b.size);
  const double preference = (rounding > 0 ? kRounded : kPreference) * size;
  const Mat3& R = difference.pose_b.rotation;
  const Face face_a = face(a, best.normal), face_b = face(b, -(R.transpose() * best.normal));
  const Vec3 normal_b = face_b.exists ? Vec3(-(R * face_b.normal)) : Vec3::Zero();
  constexpr double kNone = -std::numeric_limits<double>::infinity();
  const double s_a = face_a.exists ? difference.separation(face_a.normal) : kNone;
  const double s_b = face_b.exists ? difference.separation(normal_b) : kNone;
  const double least = best.separation - preference;
  const bool b_first = s_b > s_a + preference;
  for (const bool use_b : {b_first, !b_first}) {
    const double s = use_b ? s_b : s_a;
    if (s < least || s == kNone) continue;
    if (contact.clip_outlines(use_b ? normal_b : face_a.normal, use_b, s + 2 * preference, size)) {
      return;
    }
  }
  if (a.core != Convex::Core::polytope && b.core != Convex::Core::polytope && a.half_length > 0 &&
      contact.clip_outlines(best.normal, false, best.separation + preference, size)) {
    return;  // lines along each other
  }
  manifold.normal = pose_a.rotation * best.normal;
  contact.add(best.normal, best.on_a, best.on_a + best.separation * best.normal, best.separation,
              1);
}

void convex_plane(const Convex& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold) {
  const Pose pose = pose_b.relative_to(pose_a);
  const Vec3 n = pose.rotation * b.normal;
  const double offset = b.offset + n.dot(pose.position);
  const Outline low = outline(a, -n);
  const Frame frame(n * offset, n, std::abs(n.x()) < 0.7 ? Vec3::UnitX() : Vec3::UnitY());
  Patch patch;
  patch.count = low.count;
  for (int k = 0; k < low.count; ++k) {
    const int before = low.count == 2 ? k : (k == 0 ? low.count : k) - 1;
    patch.corners[k] = frame.corner(low.corners[k], low.names[before], low.names[k]);
  }
  const Reduced reduced = reduce(patch, margin + a.rounding, kTie * a.size);
  manifold.normal = pose_a.rotation * -n;
  for (int k = 0; k < reduced.count; ++k) {
    const PatchCorner& corner = patch.corners[reduced.index[k]];
    const Vec3 p = frame.point(corner), on_a = p - a.rounding * n, foot = p - corner.height * n;
    manifold.add({pose_a.to_world(on_a), pose_a.to_world(foot), corner.height - a.rounding,
                  corner_feature(corner, low.name)});
  }
}

}  // namespace substep::rigid
