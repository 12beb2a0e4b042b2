// What a collider does to the velocity of the material at its surface.
//
// With v the velocity relative to that of the surface and n the outward normal:
//   sticky    v = 0
//   slip      v.n = 0
//   separate  v.n >= 0
// The last two rub by the collider's `friction` mu: where the condition raises v.n by j from below
// 0, the part of v along the surface loses up to mu j, and no more than stops it. With impulses
// m dv that is Coulomb's law for the impulses of the step (Jiang et al., "The material point method
// for simulating continuum materials", SIGGRAPH course, 2016, section 12; Stomakhin et al., "A
// material point method for snow simulation", 2013, section 8). Restitution plays no part: what
// bounces is the material.
#pragma once

#include <cmath>

#include "substep/geometry/vectors.h"

namespace substep::mpm {

enum class Boundary { kSticky, kSlip, kSeparate };

// v [m/s] in the world, after the condition. n: outward normal of length 1; 0 where there is none.
inline geometry::Vec3 conditioned(const geometry::Vec3& v, const geometry::Vec3& surface_velocity,
                                  const geometry::Vec3& n, Boundary boundary, double friction) {
  if (boundary == Boundary::kSticky) return surface_velocity;
  const geometry::Vec3 relative = v - surface_velocity;
  const double normal = relative.dot(n);
  if (normal >= 0 && boundary == Boundary::kSeparate) return v;
  geometry::Vec3 along = relative - normal * n;
  const double speed = along.norm(), lost = friction * -normal;
  if (lost >= speed) {
    along.setZero();
  } else if (lost > 0) {
    along *= 1 - lost / speed;
  }
  return surface_velocity + along;
}

}  // namespace substep::mpm
