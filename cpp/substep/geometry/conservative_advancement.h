// How far a point may go without passing an obstacle.
//
// Where the free space is convex (a half space, the inside of a box or of a sphere) the straight
// way between two free points is free, so the target only moves to the nearest point that is.
// Otherwise by conservative advancement (Mirtich, "Timewarp rigid body simulation", SIGGRAPH 2000;
// for signed distances it is the sphere tracing of Hart 1996): from where the distance is d, every
// point within d / lipschitz is free. Where the way comes within `margin` of the obstacle it is
// pushed off to `margin` and goes on without its part into the obstacle, so the point slides.
#pragma once

#include "substep/geometry/collider.h"

namespace substep::geometry {

// All points are in the frame of the collider. Returns where a point that was at `from` ends on its
// way to `to`: exactly `to` where the obstacle does not come within `margin` of the way, else a
// point outside of the obstacle, at least (about) `margin` away. Long ways along a surface end
// early, after kMaxAdvances balls of free space.
Vec3 advance_freely(const Collider& collider, const Vec3& from, const Vec3& to, double margin);
inline constexpr int kMaxAdvances = 64;

// The point at distance `margin` next to x, which lies nearer to the obstacle or inside of it.
Vec3 push_out(const Collider& collider, const Vec3& x, double margin);
// Where a point goes that an obstacle was put upon: out of every wall of a tank, else to the
// nearest part of the surface.
Vec3 set_off(const Collider& collider, const Vec3& x, double margin);

}  // namespace substep::geometry
