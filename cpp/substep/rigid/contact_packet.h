// As many contacts as a vector has lanes, of which no two share a body that impulses move.
//
// In the coordinates of body_rows.h a normal impulse at point k has the gradient
//   j_k = (-s_a n, -W_a^(1/2) (r_a x n), s_b n, W_b^(1/2) (r_b x n)),  s = 1 / sqrt(m),
// and the points of a manifold act on one another by A_kl = j_k . j_l. The four normal impulses of
// a manifold are solved for together: where all of them press,
//   (A + eps max_k(A_kk) 1) d = -(j . v + target),   l <- l + d,
// else by projected Gauss and Seidel sweeps over the block. eps makes the block regular (four
// points in a plane have rank 3) and chooses the impulses that change least; as it acts on the
// change d it leaves the solution what it is (a proximal point step, Rockafellar 1976, SIAM J.
// Control Optim. 14, (1.7)). Points one by one would tilt the boxes of a stack, which is what makes
// it drift.
#pragma once

#include <cstdint>

#include "substep/core/matrix3.h"
#include "substep/rigid/body_rows.h"
#include "substep/rigid/contact_constraint.h"

namespace substep::rigid {

struct ContactPacket {
  using V = Vector<double>;
  using V3 = Vector3<V>;
  static constexpr int kLanes = sizeof(V) / sizeof(double);

  struct Settings {
    double inverse_h;   // of the sub-step
    double correction;  // part of the penetration that one sub-step takes back
    double slop;        // penetration that is left [m]
    double push;        // most that one sub-step takes back [m]
  };

  // Lane `lane` is the contact, or none.
  void set(int lane, const ContactConstraint* contact, const BodyRows& rows);
  // Everything below but the impulses, once per step.
  void prepare(const BodyRows& rows);

  // The impulses of the last sub-step, to rows.push.
  void warm_start(BodyRows& rows) const;
  // Friction, then the normal impulses: first, the separations and targets of the sub-step.
  void solve_velocities(BodyRows& rows, const Settings& settings, bool first);
  // Moves bodies apart, without velocity.
  void solve_positions(BodyRows& rows, const Settings& settings) const;

  void get(int lane, ContactConstraint& contact) const;

  std::int32_t a[kLanes], b[kLanes];       // rows
  bool moves_a[kLanes], moves_b[kLanes];   // whether impulses move them
  V separation[4], impulse[4], target[4];  // C at the begin of the step, l_n, least -u_n
  V away;                                  // added to C: a contact in flight does nothing
  V3 normal, tangent[2];
  V scale_a, scale_b;                     // s_a, s_b
  V3 arm_a[4], arm_b[4];                  // W^(1/2) (r x n); before prepare(): r
  V3 slide_a[2], slide_b[2];              // W^(1/2) (r x t), r to the middle
  V3 twist_a, twist_b;                    // W^(1/2) n
  V used[4];                              // 1 or 0
  V block[10], inverse[10], diagonal[4];  // A + eps, its inverse, 1 / its diagonal
  V slide_inverse[3], slide_bound, twist_inverse;
  V friction, spinning, lever[4];  // lever: d
  V slide_impulse[2], twist_impulse;
  // Of rolling friction, where a lane has any: W^(1/2) t, 1 / its largest mobility.
  bool rolls;
  V rolling, roll_inverse, roll_impulse[2];
  V3 roll_a[2], roll_b[2];
};

}  // namespace substep::rigid
