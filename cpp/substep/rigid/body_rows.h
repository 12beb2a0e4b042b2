// The bodies of one step in the coordinates in which all of them have mass 1 and inertia 1:
//   v' = sqrt(m) v,  w' = W^(-1/2) w  with  W = R I^-1 R^T,  W^(1/2) = R I^(-1/2) R^T.
// An impulse l with the gradient j of its constraint in these coordinates changes velocities by
// l j and reads them by j . (v', w'): one vector serves both, and a mass is 1 / (j . j).
//
// The world inertia is that of the begin of the step throughout. The angular momentum gets the
// impulses; the rotation is the free one of the whole step, turned by what the impulses added.
#pragma once

#include <cstdint>

#include "substep/core/aligned_buffer.h"
#include "substep/core/point.h"
#include "substep/rigid/bodies.h"

namespace substep::rigid {

struct BodyRows {
  using Rows = AlignedBuffer<Point<double>>;

  Rows v, w;            // velocities
  Rows free_v, free_w;  // what they would be without the contacts of this sub-step
  Rows push_v, push_w;  // what the contacts of the last sub-step changed
  Rows a, alpha;        // accelerations by gravity, forces and torques
  Rows x, r;            // displacement and rotation since the begin of the step
  // W^(1/2): (xx, yy, zz, 1 / sqrt(m)) and (xy, xz, yz, 1 if impulses move it, else 0).
  Rows root, root_mixed;
  AlignedBuffer<double> first_w;  // w' at the begin, (n, 3)

  void load(const Bodies& bodies, const Vec3& gravity, int threads);
  // v += h a + push: the contacts push as they did in the last sub-step.
  void accelerate(std::int64_t begin, std::int64_t end, double h);
  // x += h v, and notes the push. A body that no contact touched is on its parabola:
  // x += h v - h^2 a / 2, exactly.
  void move(std::int64_t begin, std::int64_t end, double h);
  // To bodies, after a step of dt.
  void store(Bodies& bodies, double dt, FreeRotation method, int threads) const;
};

}  // namespace substep::rigid
