// The equations of joints of one type, in lanes: values C at given poses, and gradients G.
//
// Row i changes at the rate  C_i' = l_i . (v_a + w_a x r_a - v_b - w_b x r_b)  or, as a turn, at
// C_i' = m_i . (w_a - w_b). With the anchors at arms r from the centres, d = p_a - p_b, the axes
// e_0 = n, e_1, e_2 of each side in the world (its frame's columns), and i = 0, 1, 2:
//   points     C = E_i . d                   l = E_i   (E_i: world)
//   across     C = e_bi . d, i = 1, 2        l = e_bi, at arms r_a and r_b + d
//   rotation   C = 2 vec(q_b^-1 q_a) . E_i   m = e_bi
//   axes       C = e_bi . (n_b x n_a)        m = n_a x (e_bi x n_b), i = 1, 2
//   angle      C = atan2(e_a1 . e_b2, e_a1 . e_b1)     m = n_b
//   along      C = n_b . d                   as across
//   distance   C = |d|                       l = d / |d|
//   cone       C = angle between n_a and n_b           m = (n_b x n_a) / |n_b x n_a|
//   cross      C = n_a . e_b1                          m = n_a x e_b1
//   turn       C = atan2(-e_a2 . e_b1, e_a1 . e_b1)    m = n_a
//   bend       C = atan2(-n_a . e_b2, n_a . n_b)       m = e_b1
//   vector     C = log(q_b^-1 q_a) . E_i, i = 0, 1, 2  m = B J^T E_i, see joint_rows.cpp
//   twist      C = 2 atan2(vec(q_b^-1 q_a) . n, w)     m = (n_a + n_b) / (1 + n_a . n_b)
// The gradients of rotation, angle, turn and bend are those at aligned axes, where joints are kept.
// A ball has points, cone and twist; a hinge points, axes and angle; a slider across, rotation and
// along; a fixed joint points and rotation; a universal joint points, cross, turn and bend; an
// elastic joint points and vector; a distance joint its one. Equations are C = 0, and come first;
// the others are coordinates, which laws rule (joint_law.h).
#pragma once

#include "substep/core/quaternion_lanes.h"
#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

inline constexpr int kJointRows = 6;  // at most

int joint_equations(JointType type);
// With the coordinates that its limits and its motor rule.
int joint_rows(const Joint& joint);
// The row of Joint::coordinate, the first of all coordinates, or -1.
int coordinate_row(JointType type);
bool is_turn(JointType type, int row);

using JointLanes = Vector<double>;
inline constexpr int kJointLanes = sizeof(JointLanes) / sizeof(double);
using JointVector = Vector3<JointLanes>;
using JointQuaternion = QuaternionLanes<JointLanes>;

// The anchors and axes of Joint::Frame.
struct JointFrames {
  JointVector anchor;
  JointQuaternion axes;

  void set(int lane, const Joint::Frame& frame);
};

// Sides of joints: their bodies' centres, the arms to the anchors in the world, and the axes.
struct JointSides {
  JointVector centre, arm;
  JointQuaternion axes;

  SUBSTEP_INLINE JointSides(const JointFrames& frames, const JointVector& x,
                            const JointQuaternion& q)
      : centre(x), arm(q.rotated(frames.anchor)), axes(q * frames.axes) {}
  // Of one joint, in all lanes.
  JointSides(const Joint::Frame& frame, const Vec3& x, const Quaternion& q);
};

// By rows; angles of a turn are those nearest to `near`; coordinates: whether those are asked for.
void joint_values(JointType type, const JointSides& a, const JointSides& b, const JointLanes& near,
                  bool coordinates, JointLanes* C);

struct JointGradients {
  JointVector axis[kJointRows];  // l or m
  JointVector arm_a, arm_b;      // where l acts
};
void joint_gradients(JointType type, const JointSides& a, const JointSides& b, JointGradients& G);

}  // namespace substep::rigid
