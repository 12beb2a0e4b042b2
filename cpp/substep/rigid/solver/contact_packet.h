// As many contacts as a vector has lanes, of which no two share a body that impulses move.
//
// A contact is seen in its own frame: axes t_1, t_2, n and the middle of its points, from which
// point k is at (p_k, q_k) along t_1 and t_2. There the bodies move relative to one another by
//   u = s_b v_b - s_a v_a + w_b x r_b - w_a x r_a,  w = W_b^(1/2) w_b' - W_a^(1/2) w_a',
// with s = 1 / sqrt(m) and the coordinates of body_rows.h, point k towards n by
// g_k . (u_n, w_1, w_2), g_k = (1, q_k, -p_k), and a force with a torque changes that by the
// symmetric mobility M (6 x 6). Normal impulses l_k act on one another by A_kl = g_k^T M g_l; all
// of a manifold are solved for together. Where all of them press,
//   (A + eps max_k(A_kk) 1) d = -(g_k . u + target),   l <- l + d,
// else by projected Gauss and Seidel sweeps over the block. eps makes the block regular (four
// points in a plane have rank 3) and chooses the impulses that change least; as it acts on the
// change d it leaves the solution what it is (a proximal point step, Rockafellar 1976, SIAM J.
// Control Optim. 14, (1.7)). Points one by one would tilt the boxes of a stack, which is what makes
// it drift.
//
// A sweep is as fast as packets come from memory, so what only shapes a step towards the solution
// (levers, mobilities) is float32; velocities and impulses are float64.
#pragma once

#include <cstdint>

#include "substep/rigid/motion/body_lanes.h"
#include "substep/rigid/solver/contact_constraint.h"

namespace substep::rigid {

struct ContactPacket {
  using V = LanesOfBodies;
  using V3 = Vector3<V>;
  static constexpr int kLanes = sizeof(V) / sizeof(double);
  static constexpr float kFarAway = 1e6F;  // separation of points that are not used [m]
  using F = Vector<float, sizeof(V) / 2>;
  using F3 = Vector3<F>;

  struct Settings {
    double inverse_h;   // of the sub-step
    double correction;  // part of the penetration that one sub-step takes back
    double slop;        // penetration that is left [m]
    double push;        // most that one sub-step takes back [m]
  };

  // Those of these lanes are these contacts, or none where it is null.
  void set(const ContactConstraint* const (&contacts)[kLanes], const bool (&lanes)[kLanes],
           const BodyRows& rows);
  // Everything below but the impulses, once per step.
  void prepare(const BodyRows& rows);

  // Whether impulses move two bodies of which one is heavier by this ratio of masses, in any lane.
  bool is_uneven(double ratio) const;
  // What the displacements have made of the separations.
  void find_separations(const BodyRows& rows, V (&C)[4]) const;
  // The separations of these lanes are those of now, not of the step's begin.
  void rebase(const BodyRows& rows, const bool (&lanes)[kLanes]);

  // This part of the impulses of the last sub-step, to what they push.
  void push(const V& part, BodyRows::Rows& rows) const { push(part, rows, moves_a, moves_b); }
  void warm_start(BodyRows& rows) const { push(splat<V>(1), rows.push); }
  // Takes them back, of rows that do not turn, before the contacts are found anew.
  void withdraw_push(BodyRows& rows) const;
  // At the start of a sub-step: moves bodies apart, without velocity, and notes the targets. What
  // is heavy is lifted off what bears it as if that were fixed.
  void solve_positions(BodyRows& rows, const Settings& settings);
  // Friction, then the normal impulses.
  void solve_velocities(BodyRows& rows);
  // The same over and over, until friction has stopped the slip or is at its bound: of an impact,
  // whose pressure is there in this sub-step only. Friction alone also turns a tall body, which
  // pressure then turns back, and so is too small at first.
  void solve_impact(BodyRows& rows);

  // What the impulses of a contact change the velocity of a, or of b, by.
  BodyRow impulse_on(int lane, bool on_b) const;
  // What the impulses do, in a unit of time, with bodies that they do not move.
  V power_of_unmoved(const BodyRows& rows) const;
  // The power of friction where it brakes, which is below 0.
  V braking(const BodyRows& rows) const;

  V pressure() const { return (impulse[0] + impulse[1]) + (impulse[2] + impulse[3]); }
  void scale_impulses(const V& part);
  void scale_impulses(int lane, double part);
  void get(int lane, ContactConstraint& contact) const;

  std::int32_t a[kLanes], b[kLanes];  // rows
  bool moves_a[kLanes], moves_b[kLanes], rolls, rolls_on;
  bool has_a, has_b, few;  // any a, any b is not the world; no contact has more than two points
  bool kinematic;          // one of the bodies is
  std::uint8_t bears_a, bears_b;  // bits of lanes: a, b bears what is much heavier
  V3 normal, tangent;
  V scale_a, scale_b;                             // s
  V mobility;                                     // max_k(A_kk), the unit of M below
  V impulse[4], slide_impulse[2], twist_impulse;  // l_n, l_t
  F3 axis_a[3], axis_b[3];                        // W^(1/2) (t_1, t_2, n)
  F3 arm_a, arm_b;                                // r
  F p[4], q[4];
  F separation[4], away, target[4];                // C at the start of the step; least -u_n
  F inverse[10];                                   // of A + eps; 0 for points that are not used
  F slide_inverse[3], slide_bound, twist_inverse;  // of M between l_t, and torques about n
  F coupling[3][3];                                // M from (l_t, torque) to (u_n, w_1, w_2)
  F friction, spinning, lever[4];                  // lever: |(p, q)|
  // What not every sweep reads.
  F used[4];                 // 1 or 0
  F block[10], diagonal[4];  // A + eps, 1 / its diagonal
  F3 bias;                   // where it rolls on, of u
  // Of rolling friction, where a lane has any: M from torques to w_1, w_2 and from l_n.
  F rolling, roll_inverse, roll_mobility[5];
  V roll_impulse[2];

 private:
  // To those rows that the last two say.
  void push(const V& part, BodyRows::Rows& rows, const bool* to_a, const bool* to_b) const;
  template <class Form>
  void solve_positions_of(Form form, BodyRows& rows, const Settings& settings);
  ContactPacket on_fixed_bearers(const BodyRows& rows) const;
};

}  // namespace substep::rigid
