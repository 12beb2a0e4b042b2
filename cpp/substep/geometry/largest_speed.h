// How fast the surface of an obstacle can be in a box, for the steps that it allows.
#pragma once

#include <algorithm>
#include <cstddef>

#include "substep/geometry/bounding_ball.h"

namespace substep::geometry {

// The largest speed of the surface of a collider in a box [m/s], or more; 0 where it does not come
// there in that time. In its frame the speed is |v + omega x (x - position)|: no point of the box
// has a larger one than one of its corners, and none of the surface than |v| + |omega| times how
// far that reaches.
inline double largest_speed(const Collider& collider, const Vec3& low, const Vec3& high,
                            double time) {
  const BoundingBall ball = ball_around(collider.shape());
  const double reach = ball.center.norm() + ball.radius;
  const double own = collider.velocity.norm(), turn = collider.angular_velocity.norm();
  const Vec3& o = collider.position();
  if ((o - o.cwiseMax(low).cwiseMin(high)).norm() > reach + own * time) return 0;
  if (turn == 0) return own;
  double in_corners = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 x;
    for (int a = 0; a < 3; ++a) x[a] = corner >> a & 1 ? high[a] : low[a];
    in_corners = std::max(in_corners, collider.surface_velocity(x).norm());
  }
  return std::min(in_corners, own + turn * reach);
}

}  // namespace substep::geometry
