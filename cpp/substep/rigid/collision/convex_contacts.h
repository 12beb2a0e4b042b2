// Any two convex shapes by their support functions: the normal from GJK or EPA, then the faces that
// look at each other along it.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/distance/gjk.h"
#include "substep/rigid/shapes/plane.h"

namespace substep::rigid {

void convex_convex(const Convex& a, const Pose& pose_a, const Convex& b, const Pose& pose_b,
                   double margin, Manifold& manifold, Cache& cache);

void convex_plane(const Convex& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold);

// The direction along which the cores are farthest apart or least deep in each other, in the frame
// of a. A separation above `enough` is no more than a proof of that.
struct Axis {
  Vec3 normal;  // from a to b
  double separation;
  Vec3 on_a;  // where b's core is closest or deepest
};
Axis best_axis(const Difference& difference, double enough);

// The flat face that a core turns to d, in its frame.
struct FlatFace {
  bool exists = false;
  Vec3 normal;
};
FlatFace flat_face(const Convex& shape, const Vec3& d);

// By how much less than the best axis a face may separate and still be taken [m]: flat contact
// keeps its points. Rounded shapes, whose normal turns at an edge, have a smaller one.
double face_preference(const Convex& a, const Convex& b);

// The height over a face with normal n, along which the cores are s apart, at which something of
// the other shape is expected if the face is to be taken: because it separates nearly as well as
// the best axis, or because a rounded shape lies along it within 1/100 rad. -infinity: not to be.
double expected_over_face(const Difference& difference, const Axis& best, const Vec3& n, double s);

}  // namespace substep::rigid
