// The normal of a contact of curved sides to full precision.
#pragma once

#include "substep/rigid/collision/convex_contacts.h"

namespace substep::rigid {

// GJK and EPA find the separation s(n) of a cylinder to 1e-9 of the size, but s is flat at its
// largest value, so that n is only good to the root of that. From there Newton's method solves for
// the n at which s is stationary: with x(n), y(n) the points of a and b farthest towards each
// other,
//   ds/dn = y - x,   d2s/dn2 = -(r / |n_p|) t t'   for each rim,
// r its radius, n_p the part of n across its axis u, t = u x n_p / |n_p| its tangent; n is of
// length 1 and stays across edges and sides that lie along the contact.
Axis refine(const Difference& difference, const Axis& axis);

}  // namespace substep::rigid
