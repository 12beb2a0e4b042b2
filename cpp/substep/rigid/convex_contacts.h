// Any two convex shapes by their support functions: the normal from GJK or EPA, then the faces that
// look at each other along it.
#pragma once

#include "substep/rigid/contact_patch.h"
#include "substep/rigid/gjk.h"

namespace substep::rigid {

void convex_convex(const Convex& a, const Pose& pose_a, const Convex& b, const Pose& pose_b,
                   double margin, Manifold& manifold, Cache& cache);

void convex_plane(const Convex& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold);

// What a core turns to a direction, in its frame: a face (count >= 3), a segment or a point.
struct Outline {
  int count = 0;
  std::uint32_t name = 0;  // of the face
  Vec3 corners[kMaxCorners];
  std::uint32_t names[kMaxCorners];  // of the corners
};
Outline outline(const Convex& shape, const Vec3& direction);

}  // namespace substep::rigid
