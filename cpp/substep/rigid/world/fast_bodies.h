// The last guard against passing through: after a step, bodies that went far for their size.
//
// What a body would meet on its way is known before the step (contact_finder.h), but what throws it
// aside in the step is not. So the ball in the middle of each of its shapes, of half the radius
// that fits, is followed along the line from where it was to where it is. Where it meets something
// that it did not touch at the beginning, the body ends its step, at its speed or, if it would gain
// energy by it, less: it is then in contact, and the next step does the rest. A body that could not
// even begin its way loses its velocity into what does not move.
#pragma once

#include <cstdint>
#include <span>

#include "substep/rigid/collision/broad_phase.h"
#include "substep/rigid/world/fixtures.h"

namespace substep::rigid {

// moved: bodies that were at fixtures.body_pose() when the step began.
void stop_fast_bodies(std::span<const std::int32_t> moved, const Fixtures& fixtures,
                      const BroadPhase& broad_phase, const Vec3& gravity, Bodies& bodies);

}  // namespace substep::rigid
