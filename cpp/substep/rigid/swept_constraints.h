// Constraints other than contacts that take part in the sweeps of ContactSolver: joints.
//
// A sub-step solves them before its contacts, packet by packet in the order of sweep(), so that no
// two packets of a phase share a row that impulses move. All work on rows in the coordinates of
// body_rows.h: an impulse l with the gradient j adds l j to velocity. Gradients may be computed
// anew in every sub-step: the pose of a body is that of the begin of the step, moved by
// scale displacement.linear and turned by the rotation vector W^(1/2) displacement.angular.
#pragma once

#include <cstdint>

#include "substep/rigid/body_rows.h"
#include "substep/rigid/graph_colouring.h"

namespace substep::rigid {

class SweptConstraints {
 public:
  virtual ~SweptConstraints() = default;

  // Once a step of sub-steps h; sweep() is that of the step from then on. Constraints of which
  // neither body moves by impulses (rows.moves) must not be in it.
  virtual void begin_step(const Bodies& bodies, const BodyRows& rows, double h, int threads) = 0;
  virtual const Sweep& sweep() const = 0;

  // Of the packet, in the first sub-step: adds to rows.push what the impulses of the last sub-step
  // of the step before change. Later ones find in rows.push what theirs did.
  virtual void warm_start(std::int64_t packet, BodyRows& rows) = 0;
  // Changes rows.velocity; first: of this sub-step, where rows.push is already applied.
  virtual void solve_velocities(std::int64_t packet, BodyRows& rows, bool first) = 0;
  // Changes rows.displacement, without velocity.
  virtual void solve_positions(std::int64_t packet, BodyRows& rows) = 0;

  // The step has succeeded: bodies have been moved.
  virtual void end_step(const BodyRows& rows) = 0;
};

}  // namespace substep::rigid
