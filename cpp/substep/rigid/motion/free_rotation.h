// The rotation of a rigid body on which no torque acts, over a time dt.
//
// State: the unit quaternion q that takes the body's principal frame into the world, and the
// angular momentum L in the world, which stays what it is, bit by bit. In the body frame m = R^T L
// obeys Euler's equations m' = m x (m / I); energy T = m . (m / I) / 2.
//
// |q| = 1 within rounding before and after; the sign of q is free.
#pragma once

#include <cstdint>

#include "substep/core/quaternion.h"
#include "substep/rigid/shapes/pose.h"

namespace substep::rigid {

enum class FreeRotation {
  kExact,       // in closed form: error of rounding only, for any dt
  kSplitting,   // symplectic, second order: energy off by O(dt^2), without drift
  kQuaternion,  // first order, the textbook's: energy drifts
  kMatrix       // the same of a rotation matrix
};

// Jacobi's solution. The attitude is the frame made of L and the axis that m circles, which is
// algebraic in sn, cn and dn, after the precession of that axis about L, an integral of the third
// kind. van Zon and Schofield 2007, "Numerical implementation of the exact dynamics of free rigid
// bodies", J. Comput. Phys. 225, section 3; Celledoni, Fasso, Saefstroem and Zanna 2008, "The exact
// computation of the free rigid body motion and its use in splitting methods", SIAM J. Sci. Comput.
// 30, section 2. Both take constants of the motion from T and |L|; here all differences are taken
// between components of m and between moments, where nothing cancels, and the addition theorems
// lead from m at any time to m after dt.
Quaternion exact_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt);

// Touma and Wisdom's symplectic splitting (splitting_rotation.h). Exact for symmetric bodies.
Quaternion splitting_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt);

// q + dt / 2 w q, normalised; w = R (m / I).
Quaternion quaternion_rotation(const Quaternion& q, const Vec3& L, const Vec3& inertia, double dt);

// R + dt [w]x R, then Gram and Schmidt's orthogonal columns.
Mat3 matrix_rotation(const Mat3& R, const Vec3& L, const Vec3& inertia, double dt);

// n bodies, rows of q (w, x, y, z), L and inertia, on the calling thread. A body's bits do not
// depend on the others.
void rotate_rows(FreeRotation method, std::int64_t n, double* q, const double* L,
                 const double* inertia, double dt);
void splitting_rows(std::int64_t n, double* q, const double* L, const double* inertia, double dt);
// The same by `steps` steps of dt.
void rotate_freely(FreeRotation method, std::int64_t n, double* q, const double* L,
                   const double* inertia, double dt, std::int64_t steps = 1, int threads = 0);

}  // namespace substep::rigid
