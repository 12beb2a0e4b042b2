// Narrow phase: from a pair of shapes to the points at which they touch.
//
// The normal n is a direction that (nearly) maximises the separation of the supporting planes
//   s(n) = min_{y in b} n.y - max_{x in a} n.x,
// which is the distance where the shapes are apart and minus the least translation that parts them
// where they overlap (separating axis theorem). The points are those of the contact patch: the face
// of one cut by the sides of the other's, reduced to four that keep the deepest and much area.
#pragma once

#include "substep/rigid/collision/manifold.h"
#include "substep/rigid/shapes/shapes.h"

namespace substep::rigid {

// The contact of a convex shape with a convex one or a plane, either way round. Points are reported
// up to a separation of `margin` [m] (>= 0). False, and no points: there are none. Meshes, which
// may touch in several planes, are collide_mesh()'s (mesh_contacts.h); InputError for them and for
// two planes.
bool collide(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b, double margin,
             Manifold& manifold, Cache& cache);

}  // namespace substep::rigid
