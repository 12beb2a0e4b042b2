// The joints of a step, within the sub-steps of the contact solver.
//
// Bodies that joints connect are solved for together, exactly, by a sparse factorization that
// takes time linear in the links of a chain or tree (joint_matrix.h), so neither long chains nor
// heavy ends need iterations. In a sub-step h, with the gradients G of the constraints C at its
// begin and the constraints of the trial motion, which turns bodies by their free rotation,
//   C(x + h v, free rotation(q, L, h)) = C(x, q),  v += M^-1 G^T l,  L += ...   (SHAKE: Ryckaert,
// Ciccotti and Berendsen 1977, J. Comput. Phys. 23; Andersen 1983, J. Comput. Phys. 52, RATTLE),
// by Newton's method on l: symplectic and of second order, so that a pendulum keeps its energy. A
// constraint on velocities at the begin alone, G v = 0, would take h w^2 / 2 of the speed of all
// that turns at w in unit time. What is left of C is taken back apart, by displacements without
// velocity, as contacts do (contact_solver.h).
//
// Bodies of joints keep their rotation and angular momentum here during a step; rows.w is what L
// means at the rotation of the sub-step's begin, in the coordinates of the step's begin.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/body_rows.h"
#include "substep/rigid/joint.h"

namespace substep::rigid {

class JointSolver {
 public:
  // Joints between bodies that impulses do not move (rows.root_mixed.w = 0) rest. pressed: of each
  // body whether a contact presses on it.
  void begin_step(const Bodies& bodies, const BodyRows& rows, std::span<const Joint> joints,
                  std::span<const std::uint8_t> pressed, double h, FreeRotation method);

  // Groups share no body that impulses move: any number of them at a time. Of each in a sub-step:
  std::int64_t groups() const;
  void begin_substep(std::int64_t group, BodyRows& rows);     // before impacts
  void warm_start(std::int64_t group, BodyRows& rows);        // after rows.accelerate
  void solve_velocities(std::int64_t group, BodyRows& rows);  // before a sweep over contacts
  void move(std::int64_t group, BodyRows& rows);              // after rows.move
  void solve_positions(std::int64_t group, BodyRows& rows, double push);  // after that of contacts
  // After the last sub-step.
  void end_step(std::int64_t group, BodyRows& rows);

  // After rows.store: rotations and angular momenta, impulses and reports.
  void store(Bodies& bodies, std::span<Joint> joints, double dt) const;
};

}  // namespace substep::rigid
