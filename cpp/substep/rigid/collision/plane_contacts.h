// Shapes against a half space: the points of the shape that are lowest above the plane. The normal
// points into the plane.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

void sphere_plane(const Sphere& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                  double margin, Manifold& manifold);
void capsule_plane(const Capsule& a, const Pose& pose_a, const Plane& b, const Pose& pose_b,
                   double margin, Manifold& manifold);
void box_plane(const Box& a, const Pose& pose_a, const Plane& b, const Pose& pose_b, double margin,
               Manifold& manifold);

}  // namespace substep::rigid
