// The contact patch of two convex shapes along a given normal: the outline of the reference shape
// cuts the other's.
#pragma once

#include <cstdint>

#include "substep/rigid/collision/contact_patch.h"
#include "substep/rigid/distance/gjk.h"

namespace substep::rigid {

// Fractions of the smaller shape's size: what a side lets pass, so that corners of aligned shapes
// stay corners; how far aside of a line another one is still along it; within which patches are
// level (outline_of_cylinder() and outline_by_support() rely on it).
inline constexpr double kSlack = 1e-4, kAside = 1e-2;
inline double level(const Convex& shape) {
  return shape.core == Convex::Core::cylinder || shape.core == Convex::Core::other ? 2e-3 : 2e-2;
}

// What a core turns to a direction, in its frame: a face (count >= 3), a segment or a point.
struct Outline {
  int count = 0;
  std::uint32_t name = 0;  // of the face
  Vec3 corners[kMaxCorners];
  std::uint32_t names[kMaxCorners];  // of the corners
};
Outline outline(const Convex& shape, const Vec3& direction);

// Coordinates over a plane through `o` with normal n.
struct PlaneFrame {
  PlaneFrame(const Vec3& origin, const Vec3& normal, const Vec3& along)
      : o(origin), n(normal), u((along - n.dot(along) * n).normalized()), v(n.cross(u)) {}
  PatchCorner corner(const Vec3& p, std::uint32_t before, std::uint32_t after) const {
    const Vec3 d = p - o;
    return {u.dot(d), v.dot(d), n.dot(d), before, after};
  }
  Vec3 point(const PatchCorner& c) const { return o + c.u * u + c.v * v + c.height * n; }
  Patch patch(const Outline& outline) const;

  Vec3 o, n, u, v;
};

// Set in the features of corners that a side has cut, not in those of the outline's own.
inline constexpr std::uint32_t kCutCorner = 1u << 31;

// Fills the manifold, in the frame of a, with normal n (from a to b). The reference is what a (or
// b) turns to the other along n: a face with that normal, or a line across it. False, and nothing
// added, where the part of the other's outline over it is nowhere as low as `expected` (separation
// of the cores). `salt` tells apart features that the names of the corners do not.
bool face_patch(const Difference& difference, const Vec3& n, bool b_is_reference, double expected,
                double margin, double size, std::uint32_t salt, Manifold& manifold);

}  // namespace substep::rigid
