// Convex shapes on a mesh of triangles.
//
// Each triangle near the shape is a convex shape of its own. Its best axis counts only where the
// mesh around supports it (TriangleMesh::supports): at an edge inside of a flat or hollow part the
// normal of the triangle takes its place, so that nothing catches on inner edges. Points with one
// normal are then one manifold, whichever triangle they are on.
#pragma once

#include <vector>

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// Appends one manifold for each direction in which the mesh and the convex shape a touch (planes
// and meshes: none). Points up to a separation of `margin`.
void collide_mesh(const Shape& a, const Pose& pose_a, const TriangleMesh& mesh, const Pose& pose_b,
                  double margin, std::vector<Manifold>& manifolds);

}  // namespace substep::rigid
