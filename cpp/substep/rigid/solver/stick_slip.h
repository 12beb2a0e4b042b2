// Static and kinetic friction: with which of them a contact goes into the next sub-step.
//
// What sticks is held by mu_s, what slips by mu_k <= mu_s until its velocity comes to 0 (the switch
// model: Leine, van Campen, de Kraker and van den Steen 1998, "Stick-slip vibrations induced by
// alternate friction models", Nonlinear Dynamics 16). Let u be the velocity with which a contact
// slips at the end of a sub-step, s that at its begin, l_n and l_t its impulses, M its mobility.
// What has stuck begins to slip if friction could not hold it, and u grows,
//   |l_t - M^-1 u| > mu_s l_n,  |u| > |s|,
// in two sub-steps, or in one if it is fast at once, faster than gravity makes it in a sub-step: a
// contact that closes within a sub-step presses in a part of it only. What slips sticks again if it
// turned round, or would stop within the next sub-step if it slowed down as in this one:
//   u . s <= 0  or  u . (2 u - s) <= 0.
// What does not press yet slips if it is fast. Spin about n is the third component of u, with the
// mean distance of the pressing points from their middle for its lever.
//
// mu is one number within a sub-step, so friction takes energy as any does.
#pragma once

#include "substep/rigid/motion/body_rows.h"
#include "substep/rigid/solver/contact_constraint.h"
#include "substep/rigid/solver/contact_packet.h"

namespace substep::rigid {

// Of a contact that does not press yet: fast is above this speed [m/s].
void begin_slip(const BodyRows& rows, double fast, ContactConstraint& contact);

// After a sub-step, of the contact in the lane.
void note_slip(const ContactPacket& packet, int lane, const BodyRows& rows, double fast,
               ContactConstraint& contact);

}  // namespace substep::rigid
