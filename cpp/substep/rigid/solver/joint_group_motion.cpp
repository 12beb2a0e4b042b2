// JointGroup: impulses, by Newton's method.
#include <algorithm>
#include <cmath>

#include "substep/core/usize.h"
#include "substep/rigid/motion/row_vectors.h"
#include "substep/rigid/solver/joint_group.h"

namespace substep::rigid {
namespace {

using Mode = JointLaw::Mode;

constexpr int kIterations = 12;
constexpr double kTolerance = 1e-12;    // of C [m], [rad]
constexpr double kEnoughMotion = 1e-6;  // the same where it does not get better

// What drives a row.
Joint::Motor motor_of(const Joint& joint, int row) {
  if (joint.type != JointType::kElastic)
    return row == coordinate_row(joint.type) ? joint.motor : Joint::Motor{};
  const Joint::Spring& spring = joint.spring;
  const int i = row - coordinate_row(joint.type);
  return {.type = MotorType::kSpring,
          .target = spring.rest[i],
          .stiffness = i == 0 ? spring.twist_stiffness : spring.swing_stiffness,
          .damping = i == 0 ? spring.twist_damping : spring.swing_damping};
}

}  // namespace

double JointGroup::rate(const Link& link, int row, const BodyRows& rows) const {
  const Member &a = members_[usize(link.a)], &b = members_[usize(link.b)];
  const Vec3 v = a.scale * from_row(rows.velocity[usize(a.row)].linear) -
                 b.scale * from_row(rows.velocity[usize(b.row)].linear);
  return link.G.linear[row].dot(v) + link.G.angular_a[row].dot(a.W * momentum(usize(link.a))) -
         link.G.angular_b[row].dot(b.W * momentum(usize(link.b)));
}

double JointGroup::rate_before(const Link& link, int row) const {
  const Member &a = members_[usize(link.a)], &b = members_[usize(link.b)];
  return link.G.linear[row].dot(a.v_before - b.v_before) + link.G.angular_a[row].dot(a.w_before) -
         link.G.angular_b[row].dot(b.w_before);
}

// Limits that are passed already are no bias: they are for solve_positions().
void JointGroup::set_laws(Link& link, Stage stage) {
  const double h = settings_.h;
  const Joint& joint = link.joint;
  for (int row = link.equations; row < link.rows; ++row) {
    const std::size_t k = usize(row - link.equations);
    const double y = link.begin[usize(row)];
    const bool own = row == coordinate_row(joint.type);
    const double lower = own ? joint.lower : -Joint::kInfinite;
    const double upper = own ? joint.upper : joint.cone;
    JointLaw& law = link.law[k];
    law = {};
    if (lower == upper) {
      law.slowest = law.fastest = 0;
    } else if (stage == Stage::kMotion) {
      law.slowest = std::min(lower - y, 0.) / h;
      law.fastest = std::max(upper - y, 0.) / h;
    } else {
      if (link.mode[k] == Mode::kLower) law.slowest = 0;
      if (link.mode[k] == Mode::kUpper) law.fastest = 0;
    }
    const Joint::Motor motor = motor_of(joint, row);
    if (motor.type == MotorType::kNone) continue;
    law.driven = true;
    law.most = weight_ * h * motor.most;
    if (motor.type == MotorType::kSpeed) {
      law.rate = motor.target;
    } else {
      // The half kick that begins a step damps what the last one left, u, as long as that does not
      // turn it back: then both together are of second order.
      const double mass = 1 / link.mobility[usize(row)], half = 0.5 * h * motor.damping;
      const bool begins = stage == Stage::kMotion && weight_ < 1;
      const double D =
          std::max(0.25 * h * h * motor.stiffness + (begins ? std::max(half - mass, 0.) : half),
                   1e-6 * mass);
      const double u = rate_before(link, row);
      const double impulse =
          -weight_ * h * (motor.stiffness * (y - motor.target) + motor.damping * u);
      law.rate = u + impulse / D;
      law.compliance = 1 / D;
    }
  }
}

// Where the velocities lead to.
void JointGroup::find_trial(const BodyRows& rows) {
  for (std::size_t k = 0; k < members_.size(); ++k) {
    Member& m = members_[k];
    m.seen_velocity = from_row(rows.velocity[usize(m.row)].linear);
    trial_[k].x = m.origin + m.scale * (m.start + settings_.h * m.seen_velocity);
    store_quaternion(m.now.q, &q_[4 * k]);
  }
  rotate_rows(settings_.method, static_cast<std::int64_t>(members_.size()), q_.data(), L_.data(),
              inertia_.data(), settings_.h);
  for (std::size_t k = 0; k < members_.size(); ++k) trial_[k].q = load_quaternion(&q_[4 * k]);
  tried_ = true;
}

void JointGroup::choose_modes(Stage stage, BodyRows& rows, bool& changed, bool& applied) {
  for (Link& link : links_) {
    if (link.rows == link.equations) continue;
    std::array<double, kJointRows> C{};
    if (stage == Stage::kMotion) C = values(link, true);
    for (int row = link.equations; row < link.rows; ++row) {
      const std::size_t k = usize(row - link.equations);
      const double u = stage == Stage::kMotion
                           ? (C[usize(row)] - link.begin[usize(row)]) / settings_.h
                           : rate(link, row, rows);
      const Mode mode = link.law[k].mode(u, link.impulse[usize(row)], link.mobility[usize(row)]);
      if (mode != link.mode[k]) changed = true;
      link.mode[k] = mode;
      if (!JointLaw::fixes_impulse(mode)) continue;
      const double change = link.law[k].fixed_impulse(mode) - link.impulse[usize(row)];
      if (change == 0) continue;
      Impulses alone{};
      alone[usize(row)] = change;
      apply(link, alone, rows);
      applied = true;
    }
  }
  if (applied) write_momenta(rows);
}

// The largest error of C at the end of the sub-step.
double JointGroup::find_residuals(Stage stage, const BodyRows& rows) {
  double worst = 0;
  for (std::size_t j = 0; j < links_.size(); ++j) {
    const Link& link = links_[j];
    std::array<double, kJointRows> C{};
    if (stage == Stage::kMotion) C = values(link, true);
    pieces_[j].fill(0);
    for (int row = 0; row < link.rows; ++row) {
      if (!link.active(row)) continue;
      double u = stage == Stage::kMotion ? (C[usize(row)] - link.begin[usize(row)]) / settings_.h
                                         : rate(link, row, rows);
      if (row >= link.equations) {
        const std::size_t k = usize(row - link.equations);
        u = link.law[k].residual(link.mode[k], u, link.impulse[usize(row)]);
      }
      u += regularisation_ * link.mobility[usize(row)] * link.impulse[usize(row)];
      pieces_[j][usize(row)] = u;
      worst = std::max(worst, settings_.h * std::abs(u));
    }
  }
  return worst;
}

// Newton's method; ends where rounding does. Returns whether it has found the solution.
bool JointGroup::iterate(Stage stage, BodyRows& rows) {
  double last = Joint::kInfinite;
  for (int k = 0; k < kIterations; ++k) {
    bool changed = false, applied = false;
    if (stage == Stage::kMotion) find_trial(rows);
    choose_modes(stage, rows, changed, applied);
    if (applied && stage == Stage::kMotion) find_trial(rows);
    const double worst = find_residuals(stage, rows);
    if (!changed && (worst < kTolerance || (k > 2 && worst > 0.5 * last && worst < kEnoughMotion)))
      return true;
    last = worst;
    if (changed || !factored_) factor();
    matrix_.solve(pieces_);
    for (std::size_t j = 0; j < links_.size(); ++j) apply(links_[j], pieces_[j], rows);
    write_momenta(rows);
  }
  return last < kEnoughMotion;
}

// Where no motion that fulfils the constraints is near (a chain that snaps taut), the velocities
// do, which takes energy and so is stable.
void JointGroup::solve_motion(BodyRows& rows) {
  if (iterate(Stage::kMotion, rows)) return;
  for (Link& link : links_) {
    Impulses back = link.impulse;
    for (double& l : back) l = -l;
    apply(link, back, rows);
    link.impulse.fill(0);
  }
  write_momenta(rows);
  iterate(Stage::kVelocity, rows);
}

void JointGroup::solve_velocities(BodyRows& rows, bool first) {
  if (first) {
    begin_substep(rows);
  } else if (!read_momenta(rows) && tried_) {
    return;
  }
  solve_motion(rows);
}

}  // namespace substep::rigid
