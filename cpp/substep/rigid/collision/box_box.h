// Box against box: separating axes (Gottschalk, Lin, Manocha, "OBBTree", SIGGRAPH 1996, section 5),
// then the face clipped or the crossing of two edges.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

void box_box(const Box& a, const Pose& pose_a, const Box& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache);

}  // namespace substep::rigid
