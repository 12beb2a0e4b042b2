#include "substep/rigid/world/supports.h"

#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"
#include "substep/rigid/solver/islands.h"

namespace substep::rigid {
namespace {

constexpr double kNear = 1e-6;  // an end [m], [rad]

bool presses(const ContactConstraint& c) {
  return std::any_of(c.points, c.points + c.count, [](const auto& p) { return p.total > 0; });
}

bool is_at_end(const Joint& joint) {
  if (joint.type == JointType::kDistance)
    return joint.lower < joint.upper && joint.motor.type == MotorType::kNone &&
           !joint.force.isZero(0);
  if (std::isfinite(joint.cone) && !joint.torque.isZero(0)) return true;
  return joint.effort != 0 &&
         (joint.coordinate <= joint.lower + kNear || joint.coordinate >= joint.upper - kNear);
}

}  // namespace

std::vector<std::uint8_t> supported_bodies(const World& world) {
  const Bodies& bodies = world.bodies();
  std::vector<std::uint8_t> held(usize(bodies.size()));
  for (const ContactConstraint& c : world.contacts())
    if (presses(c)) held[usize(c.a)] = held[usize(c.b)] = 1;
  std::vector<BodyPair> stiff;
  for (const Joint& joint : world.joints()) {
    if (is_at_end(joint)) {
      held[usize(joint.a)] = 1;
      if (joint.b >= 0) held[usize(joint.b)] = 1;
    }
    if (joint.b >= 0 && bodies.dynamic(joint.a) && bodies.dynamic(joint.b) &&
        joint.type != JointType::kElastic && joint.motor.type != MotorType::kSpring)
      stiff.push_back({joint.a, joint.b});
  }
  if (stiff.empty()) return held;
  std::vector<std::int32_t> label(held.size());
  label_islands(stiff, label);
  for (std::size_t i = 0; i < held.size(); ++i) held[usize(label[i])] |= held[i];
  for (std::size_t i = 0; i < held.size(); ++i) held[i] = held[usize(label[i])];
  return held;
}

}  // namespace substep::rigid
