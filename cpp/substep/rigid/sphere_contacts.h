// A sphere against shapes with a closed form of their distance.
#pragma once

#include "substep/rigid/manifold.h"
#include "substep/rigid/shapes.h"

namespace substep::rigid {

void sphere_sphere(const Sphere& a, const Pose& pose_a, const Sphere& b, const Pose& pose_b,
                   double margin, Manifold& manifold);

}  // namespace substep::rigid
