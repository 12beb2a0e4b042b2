// A sphere against shapes with a closed form of their distance.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

void sphere_sphere(const Sphere& a, const Pose& pose_a, const Sphere& b, const Pose& pose_b,
                   double margin, Manifold& manifold);
void sphere_capsule(const Sphere& a, const Pose& pose_a, const Capsule& b, const Pose& pose_b,
                    double margin, Manifold& manifold);
void sphere_box(const Sphere& a, const Pose& pose_a, const Box& b, const Pose& pose_b,
                double margin, Manifold& manifold);

}  // namespace substep::rigid
