// How deep two convex sets that overlap are in each other: the expanding polytope algorithm (van
// den Bergen, "Proximity queries and penetration depth computation on 3D game objects", GDC 2001).
// A polytope inside b - a grows at the face closest to the origin until that face lies on its
// surface.
#pragma once

#include "substep/rigid/distance/gjk.h"

namespace substep::rigid {

struct Penetration {
  Vec3 normal;        // from a to b, in the frame of a
  double separation;  // s(normal) of the cores, below 0 or as good as 0
  Vec3 on_a;          // the point of a's core where b is deepest
};

// `simplex` is what distance() ended with.
Penetration penetration(const Difference& difference, const Simplex& simplex);

}  // namespace substep::rigid
