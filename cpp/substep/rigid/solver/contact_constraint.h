// A contact as the solvers see it: a manifold, what its surfaces are like, and the impulses.
//
// With the relative velocity at a point, u = v_b + w_b x r_b - v_a - w_a x r_a, u_n = n . u and u_t
// its part along the surfaces, and impulses l_n along n and l_t across it, b receiving them and a
// their opposite:
//   0 <= l_n  _|_  C >= 0                    non-penetration, C the separation (Signorini)
//   |l_t| <= mu l_n, and l_t = -mu l_n u_t / |u_t| where it slides            (Coulomb's cone)
//   u_n after = -e u_n before, of an impact                                  (Newton)
// Friction acts on a manifold as one force at the middle of its points and one torque about n: what
// four forces in a plane add up to. mu sum(l_n) bounds the force, the torque is bounded by
//   mu sum(l_n d) + spinning sum(l_n),
// d the distances of the points from their middle: exact for slip alone and for spin alone. Rolling
// friction is a torque along the surfaces against their relative angular velocity w_t there,
//   |l_r| <= rolling sum(l_n), and l_r = -rolling sum(l_n) w_t / |w_t| where they roll.
// mu is that of static or of kinetic friction (stick_slip.h).
#pragma once

#include <algorithm>
#include <cstdint>

#include "substep/rigid/collision/manifold.h"

namespace substep::rigid {

struct ContactConstraint {
  struct Point {
    Vec3 position = Vec3::Zero();                   // in the world, midway between the surfaces
    double separation = 0.0;                        // C at the start of the step [m]
    double impulse = 0.0;                           // l_n of the last sub-step [N s]
    double total = 0.0;                             // of the last step, with its impacts
    Vec3 in_a = Vec3::Zero(), in_b = Vec3::Zero();  // in the frames of the bodies
    // From the centres of the bodies, in the world: where impulses act. Of bodies that meet later
    // in the step as they are then, when neither is where it is now.
    Vec3 arm_a = Vec3::Zero(), arm_b = Vec3::Zero();
  };

  // What whole lists are searched for comes first.
  std::int32_t a = 0, b = 0;  // numbers of bodies; one of them is dynamic
  std::int32_t fixture_a = 0, fixture_b = 0;
  int count = 0;
  bool slips = false;     // mu is that of kinetic friction
  bool tips = false;      // of bodies that turn farther in a step than was looked
  bool rolls_on = false;  // of shapes that touch elsewhere within a step, as they roll
  double friction = 0.5, restitution = 0.0;
  double static_friction = 0.0;  // where it is above friction
  double spinning = 0.0;         // [m], lever of the friction that resists spin about n
  double rolling = 0.0;          // [m], of that which resists rolling

  Vec3 normal = Vec3::UnitZ();   // of length 1, from a to b
  Vec3 tangent = Vec3::UnitX();  // of length 1, across it: first direction of friction
  Point points[4];
  double friction_impulse[2] = {0., 0.};  // of the last sub-step, along the tangent and n x tangent
  double twist_impulse = 0.0;             // of the last sub-step [N m s]
  double roll_impulse[2] = {0., 0.};      // the same along the tangent and n x tangent
  double friction_total[2] = {0., 0.};    // of the last step, with its impacts
  double load = 0.0;                      // what of sum(l_n) is of no impact (impact_start.h)
  // With which velocity [m/s], after the last sub-step: along the tangent, n x tangent, and of the
  // points about n. Also of a contact that only begins to; 0 where it sticks.
  double slip[3] = {0., 0., 0.};
  double margin = 0;  // how far its shapes are looked at in sub-steps then [m]

  // Point k or, where it has fewer by the end of a step, its last one.
  Point& last_of(int k) { return points[std::max(0, std::min(k, count - 1))]; }

  double mu() const { return slips ? friction : std::max(friction, static_friction); }

  // Of the points: of their positions, of their arms.
  Vec3 middle(Vec3 Point::* which) const {
    Vec3 sum = Vec3::Zero();
    for (int k = 0; k < count; ++k) sum += points[k].*which;
    return count > 0 ? Vec3(sum / count) : sum;
  }
};

// Whether it has two coefficients of friction.
inline bool sticks_more(const ContactConstraint& c) { return c.static_friction > c.friction; }

// Contacts are in the order of their shapes.
inline bool precedes(const ContactConstraint& c, const ContactConstraint& d) {
  return c.fixture_a != d.fixture_a ? c.fixture_a < d.fixture_a : c.fixture_b < d.fixture_b;
}

// Whether the last impulses press on at least three points, with friction and the torque about the
// normal below 0.9 of their bounds: neither body moves relative to the other.
bool holds(const ContactConstraint& contact);

// The contact of bodies a and b at these poses, without impulses, which will act at this part of
// the way from the surface of a to that of b.
ContactConstraint make_contact(const Manifold& manifold, std::int32_t a, const Pose& pose_a,
                               std::int32_t b, const Pose& pose_b, double part = 0.5);

// Gives a contact the impulses that the same two shapes had a step before. Points are the same if
// they are near in the frame of one of the bodies or, of what rolls, around the middle of all: the
// names of features are not enough, as those of equal boxes on one another change with every
// rounding, and a stack that loses impulses with them shakes.
void carry_impulses(const ContactConstraint& last, ContactConstraint& now);

}  // namespace substep::rigid
