// Bodies and joints without contacts, for tests of joints.
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include "constants.h"
#include "substep/rigid/solver/contact_solver.h"

namespace substep::rigid {

struct JointScene {
  Bodies bodies;
  std::vector<Joint> joints;
  ContactSolver solver;
  ContactOptions options;
  Vec3 gravity{0, 0, -g};
  int threads = 1;
  double length_error = 0, angle_error = 0;  // largest of all steps

  std::int32_t add_box(const Vec3& half, const Vec3& position, double mass = 1,
                       const Quaternion& rotation = Quaternion::Identity()) {
    const Vec3 s = half.cwiseProduct(half);
    return static_cast<std::int32_t>(
        bodies.add({.position = position,
                    .rotation = rotation,
                    .mass = mass,
                    .inertia = mass / 3 * Vec3(s.y() + s.z(), s.x() + s.z(), s.x() + s.y())}));
  }
  void add(const Joint& joint) {
    check_joint(joint, bodies);
    joints.push_back(joint);
  }
  void step(double dt) {
    ASSERT_EQ(solver.step(bodies, gravity, dt, {}, options, {}, joints, threads), -1);
    for (const Joint& joint : joints) {
      length_error = std::max(length_error, joint.length_error);
      angle_error = std::max(angle_error, joint.angle_error);
    }
  }
  void advance(double duration, double dt = 1. / 60) {
    for (int k = 0; k < std::lround(duration / dt); ++k) step(dt);
  }
  double energy() const { return bodies.kinetic_energy() + bodies.potential_energy(gravity); }
};

}  // namespace substep::rigid
