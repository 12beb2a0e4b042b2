// Capsules against capsules and boxes.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// Both return false, and have done nothing, for what is left to convex_convex(): axes that are
// nearly parallel, or that cross the other shape's core.
bool capsule_capsule(const Capsule& a, const Pose& pose_a, const Capsule& b, const Pose& pose_b,
                     double margin, Manifold& manifold);
bool capsule_box(const Capsule& a, const Pose& pose_a, const Box& b, const Pose& pose_b,
                 double margin, Manifold& manifold);

}  // namespace substep::rigid
