// The joints of a step, within the sub-steps of the contact solver.
//
// Bodies that joints connect are solved for together, exactly, by a sparse factorization that
// takes time linear in the links of a chain or tree (joint_matrix.h), so neither long chains nor
// heavy ends need iterations. In a sub-step h the impulses l along the gradients G of the
// constraints C at its begin are those with which the motion ends where C is what it was,
//   v += M^-1 G^T l + h a,   C(x + h v, rotation of (q, L) in h) = C(x, q),
// the rotation being the free one, by Newton's method: SHAKE (Ryckaert, Ciccotti and Berendsen
// 1977, J. Comput. Phys. 23), symplectic and of second order, so that a pendulum keeps its energy.
// A constraint on velocities at the start alone, G v = 0, would take the part h w^2 / 2 of the
// speed of all that turns at w in unit time. What is left of C is taken back apart, by
// displacements without velocity, as contacts do (contact_solver.h).
//
// Velocities of SHAKE are those between the steps. Where no contact presses on bodies of a group, a
// step begins with half a kick back and ends with half a kick and a projection on G v = 0 (RATTLE:
// Andersen 1983, J. Comput. Phys. 52), so that its velocities are those of its time. Elsewhere, as
// for contacts, the velocities of the last sub-step are taken for it.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/rigid/solver/contact_constraint.h"
#include "substep/rigid/solver/joint_group.h"
#include "substep/rigid/solver/tree_group.h"

namespace substep::rigid {

class JointSolver {
 public:
  // Joints of which neither body moves by impulses rest, as those that ask for nothing. Changes
  // rows.velocity.
  void begin_step(const Bodies& bodies, std::span<const Joint> joints,
                  std::span<const ContactConstraint> contacts, const JointGroup::Settings& settings,
                  BodyRows& rows);

  // Bodies that joints connect. In each step by TreeGroup where that serves, else by JointGroup.
  class Group {
   public:
    Group(std::vector<std::int32_t> numbers, std::span<const Joint> joints, const BodyRows& rows)
        : tree_(TreeGroup::make(numbers, joints, rows)),
          general_(std::move(numbers), joints, rows) {}

    void begin_step(std::span<const Joint> joints, std::span<const std::uint8_t> pressed,
                    const Bodies& bodies, const JointGroup::Settings& settings, BodyRows& rows) {
      by_tree_ = tree_ && tree_->begin_step(joints, pressed, bodies, settings, rows);
      if (!by_tree_) general_.begin_step(joints, pressed, bodies, settings, rows);
    }
    void solve_velocities(BodyRows& rows, bool first, bool last) {
      if (by_tree_) {
        tree_->solve_velocities(rows, first, last);
      } else {
        general_.solve_velocities(rows, first, last);
      }
    }
    void move(BodyRows& rows) {
      if (by_tree_) {
        tree_->move(rows);
      } else {
        general_.move(rows);
        general_.solve_positions(rows);
      }
    }
    void end_step(BodyRows& rows) {
      if (by_tree_) {
        tree_->end_step(rows);
      } else {
        general_.end_step(rows);
      }
    }
    void store(Bodies& bodies, std::span<Joint> joints, double dt) const {
      if (by_tree_) {
        tree_->store(bodies, joints, dt);
      } else {
        general_.store(bodies, joints, dt);
      }
    }
    bool whirls() const { return by_tree_ ? tree_->whirls() : general_.whirls(); }
    void mark_bodies(std::span<std::uint8_t> bodies) const { general_.mark_bodies(bodies); }

   private:
    std::optional<TreeGroup> tree_;
    JointGroup general_;
    bool by_tree_ = false;
  };

  // Share no body that impulses move.
  std::int64_t groups() const { return static_cast<std::int64_t>(groups_.size()); }
  Group& group(std::int64_t k) { return groups_[usize(k)]; }

  // Of each body, not 0 where its group whirls.
  void mark_whirling(std::span<std::uint8_t> bodies) const;

  // After rows.store: rotations, angular momenta, and the state and reports of joints.
  void store(Bodies& bodies, std::span<Joint> joints, double dt) const;

 private:
  void find_groups(const Bodies& bodies, std::span<const Joint> joints, const BodyRows& rows);

  struct Key {
    std::int32_t number, a, b;
    JointType type;
    int rows;
    bool moves_a, moves_b;
    bool stands_a, stands_b;  // as the world does
    bool operator==(const Key&) const = default;
  };
  std::vector<Key> keys_, found_;
  std::vector<Group> groups_;
  std::vector<std::uint8_t> pressed_;
  std::vector<std::int32_t> label_;
};

}  // namespace substep::rigid
