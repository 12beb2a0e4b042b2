#include "substep/rigid/solver/joint_law.h"

#include <algorithm>

namespace substep::rigid {

// Limits that are passed already are no bias: positions are taken back by themselves.
JointLaw JointLaw::make(const Joint::Motor& motor, double lower, double upper,
                        const Interval& interval, Stage stage, Mode mode, double y, double u,
                        double mass) {
  const double h = interval.h, weight = interval.weight;
  JointLaw law;
  law.before = u;
  if (lower == upper) {
    law.slowest = law.fastest = interval.closes && stage == Stage::kMotion ? (lower - y) / h : 0;
  } else if (stage == Stage::kMotion) {
    law.slowest = std::min(lower - y, 0.) / h;
    law.fastest = std::max(upper - y, 0.) / h;
  } else {
    if (mode == Mode::kLower) law.slowest = 0;
    if (mode == Mode::kUpper) law.fastest = 0;
  }
  if (motor.type == MotorType::kNone) return law;
  law.driven = true;
  law.most = weight * h * motor.most;
  if (motor.type == MotorType::kSpeed) {
    law.rate = motor.target;
    return law;
  }
  // What contacts do between would feed a spring, so that a part of it is implicit there. The half
  // kick that begins a step damps what the last one left, u, as long as that does not turn it back:
  // then both together are of second order.
  const double part = interval.smooth ? 0 : 0.5 * h * (h * motor.stiffness + motor.damping);
  const double half = 0.5 * h * motor.damping;
  const bool begins = stage == Stage::kMotion && weight < 1;
  const double D =
      std::max(0.25 * h * h * motor.stiffness + (begins ? std::max(half - mass, 0.) : half) + part,
               1e-6 * mass);
  const double impulse =
      -weight * h * (motor.stiffness * (y - motor.target) + motor.damping * u) - part * u;
  law.rate = u + impulse / D;
  law.compliance = 1 / D;
  return law;
}

}  // namespace substep::rigid
