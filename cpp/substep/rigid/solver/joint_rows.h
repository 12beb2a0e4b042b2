// The equations of a joint: values C at given poses, and gradients G.
//
// Row i changes at the rate  C_i' = l_i . (v_a - v_b) + m_i . w_a - n_i . w_b  (linear l, angular_a
// m, angular_b n). With the anchors at arms r from the centres, d = p_a - p_b, the axes e_0 = n,
// e_1, e_2 of each side in the world (its frame's columns), and i = 0, 1, 2:
//   points     C = E_i . d                   l = E_i   m = r_a x E_i   n = r_b x E_i   (E_i: world)
//   across     C = e_bi . d, i = 1, 2        l = e_bi  m = r_a x e_bi  n = (r_b + d) x e_bi
//   rotation   C = 2 vec(q_b^-1 q_a) . E_i   l = 0     m = n = e_bi
//   axes       C = e_bi . (n_b x n_a)        l = 0     m = n = n_a x (e_bi x n_b), i = 1, 2
//   angle      C = atan2(e_a1 . e_b2, e_a1 . e_b1)     m = n = n_b
//   along      C = n_b . d                   as across
//   distance   C = |d|                       l = d / |d|, m = r_a x l, n = r_b x l
//   cone       C = angle between n_a and n_b           m = n = (n_b x n_a) / |n_b x n_a|
//   cross      C = n_a . e_b1                          m = n = n_a x e_b1
//   turn       C = atan2(-e_a2 . e_b1, e_a1 . e_b1)    m = n = n_a
//   bend       C = atan2(-n_a . e_b2, n_a . n_b)       m = n = e_b1
//   vector     C = log(q_b^-1 q_a) . E_i, i = 0, 1, 2  m = n = B J^T E_i, see joint_rows.cpp
//   twist      C = 2 atan2(vec(q_b^-1 q_a) . n, w)     m = n = (n_a + n_b) / (1 + n_a . n_b)
// The gradients of rotation, angle, turn and bend are those at aligned axes, where joints are kept.
// A ball has points, cone and twist; a hinge points, axes and angle; a slider across, rotation and
// along; a fixed joint points and rotation; a universal joint points, cross, turn and bend; an
// elastic joint points and vector; a distance joint its one. Equations are C = 0, and come first;
// the others are coordinates, which laws rule (joint_law.h).
#pragma once

#include <array>

#include "substep/rigid/solver/joint.h"

namespace substep::rigid {

inline constexpr int kJointRows = 6;  // at most

int joint_equations(JointType type);
// With the coordinates that its limits and its motor rule.
int joint_rows(const Joint& joint);
// The row of Joint::coordinate, the first of all coordinates, or -1.
int coordinate_row(JointType type);

// q v, inlined: calls of Eigen's product were a large part of what values cost.
__attribute__((always_inline)) inline Vec3 rotated(const Quaternion& q, const Vec3& v) {
  const double w = q.w(), x = q.x(), y = q.y(), z = q.z(), a = v.x(), b = v.y(), c = v.z();
  const double s = 2 * (y * c - z * b), t = 2 * (z * a - x * c), u = 2 * (x * b - y * a);
  return {a + w * s + (y * u - z * t), b + w * t + (z * s - x * u), c + w * u + (x * t - y * s)};
}

// A side of a joint: its body's centre, the arm to the anchor in the world, and the axes.
struct JointSide {
  Vec3 centre, arm;
  Quaternion axes;

  JointSide(const Joint::Frame& frame, const Vec3& x, const Quaternion& q)
      : centre(x), arm(rotated(q, frame.anchor)), axes(q * frame.axes) {}
};

// Angles of a turn are those nearest to `near`; coordinates: whether those are asked for.
std::array<double, kJointRows> joint_values(JointType type, const JointSide& a, const JointSide& b,
                                            double near, bool coordinates = true);

struct JointGradients {
  Vec3 linear[kJointRows], angular_a[kJointRows], angular_b[kJointRows];
};
JointGradients joint_gradients(JointType type, const JointSide& a, const JointSide& b);

}  // namespace substep::rigid
