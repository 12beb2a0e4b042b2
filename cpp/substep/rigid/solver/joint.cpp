#include "substep/rigid/solver/joint.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/rigid/solver/joint_rows.h"

namespace substep::rigid {
namespace {

void check(bool holds, const std::string& what) {
  if (!holds) throw InputError(what);
}

void check_body(std::int32_t body, const Bodies& bodies, const char* name, std::int32_t least) {
  check(body >= least && body < bodies.size(),
        std::string(name) + ": expected the number of a body from 0 to " +
            std::to_string(bodies.size() - 1) + (least < 0 ? ", or -1 for the world" : "") +
            ", got " + std::to_string(body));
}

void check_numbers(const Bodies& bodies, std::int32_t a, std::int32_t b) {
  check_body(a, bodies, "a", 0);
  check_body(b, bodies, "b", Joint::kWorld);
  check(a != b, "b: a joint connects two bodies, got body " + std::to_string(a) + " twice");
}

// Of a new joint; later its bodies may become kinematic or static, and it rests.
void check_pair(const Bodies& bodies, std::int32_t a, std::int32_t b) {
  check_numbers(bodies, a, b);
  check(bodies.dynamic(a) || (b >= 0 && bodies.dynamic(b)),
        "a, b: a joint needs a dynamic body, and neither " + std::to_string(a) + " nor " +
            (b < 0 ? "the world" : std::to_string(b)) + " is one");
}

// The frame with the origin and axes (in the world), of the body or the world.
Joint::Frame frame_in(const Bodies& bodies, std::int32_t body, const Vec3& origin,
                      const Quaternion& axes) {
  if (body < 0) return {origin, axes};
  const Quaternion back = bodies.rotation(body).conjugate();
  return {back * (origin - bodies.position(body)), (back * axes).normalized()};
}

// The shortest rotation that takes x into a direction: Eigen's FromTwoVectors, which would compile
// a singular value decomposition for directions along -x. There it is half a turn about an axis
// across.
Quaternion turn_of_x(const Vec3& direction) {
  const Vec3 x = Vec3::UnitX(), v = direction.normalized();
  const double c = v.dot(x);
  if (c < -1 + 1e-12) {
    const double square = (1 + std::max(c, -1.0)) * 0.5, size = std::hypot(v.y(), v.z());
    const double scale = std::sqrt(1 - square) * (size > 0 ? (v.y() < 0 ? -1 : 1) / size : 1);
    const double y = size > 0 ? -v.z() : 0, z = size > 0 ? v.y() : 1;
    return {std::sqrt(square), 0, scale * y, scale * z};
  }
  const Vec3 axis = x.cross(v);
  const double s = std::sqrt((1 + c) * 2), inverse = 1 / s;
  return {s * 0.5, inverse * axis.x(), inverse * axis.y(), inverse * axis.z()};
}

Vec3 unit(const Vec3& axis, const std::string& name) {
  const double largest = axis.cwiseAbs().maxCoeff();
  check(axis.allFinite() && largest > 0, name + ": expected finite numbers that are not all 0");
  return (axis / largest).normalized();
}

Joint make(JointType type, const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
           const Quaternion& axes) {
  check_pair(bodies, a, b);
  check(anchor.allFinite(), "anchor: expected finite numbers");
  Joint joint;
  joint.type = type;
  joint.a = a, joint.b = b;
  joint.in_a = frame_in(bodies, a, anchor, axes);
  joint.in_b = frame_in(bodies, b, anchor, axes);
  return joint;
}

Joint make(JointType type, const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
           const Vec3& axis) {
  return make(type, bodies, a, b, anchor, turn_of_x(unit(axis, "axis")).normalized());
}

JointSides side_of(const Joint::Frame& frame, std::int32_t body, const Bodies& bodies) {
  return body < 0 ? JointSides(frame, Vec3::Zero(), Quaternion::Identity())
                  : JointSides(frame, bodies.position(body), bodies.rotation(body));
}

Vec3 first_lane(const JointVector& v) { return {v[0][0], v[1][0], v[2][0]}; }

void check_motor(const Joint& joint) {
  const Joint::Motor& motor = joint.motor;
  if (motor.type == MotorType::kNone) return;
  check(motor.type == MotorType::kSpeed || motor.type == MotorType::kSpring,
        "motor: there is no such kind");
  check(joint.type != JointType::kBall && joint.type != JointType::kFixed &&
            joint.type != JointType::kElastic,
        "motor: only hinges, sliders, universal and distance joints have one");
  check(std::isfinite(motor.target), "motor.target: expected a finite number");
  check(motor.most >= 0, "motor.most: expected a number not below 0");
  if (motor.type == MotorType::kSpeed) return;
  check(motor.stiffness >= 0 && std::isfinite(motor.stiffness),
        "motor.stiffness: expected a finite number not below 0");
  check(motor.damping >= 0 && std::isfinite(motor.damping),
        "motor.damping: expected a finite number not below 0");
  check(motor.stiffness > 0 || motor.damping > 0,
        "motor.stiffness, motor.damping: expected one of them above 0");
}

void check_spring(const Joint::Spring& spring) {
  check(spring.rest.allFinite() && spring.rest.norm() < std::numbers::pi,
        "spring.rest: expected a rotation vector shorter than pi");
  for (const double value :
       {spring.twist_stiffness, spring.swing_stiffness, spring.twist_damping, spring.swing_damping})
    check(value >= 0 && std::isfinite(value),
          "spring: expected finite stiffness and damping not below 0");
}

void check_limits(const Joint& joint) {
  const double lower = joint.lower, upper = joint.upper;
  check(lower <= upper, "lower, upper: expected lower <= upper, got " + std::to_string(lower) +
                            " and " + std::to_string(upper));
  check(lower < Joint::kInfinite && upper > -Joint::kInfinite,
        "lower, upper: expected limits that a finite number is within");
  switch (joint.type) {
    case JointType::kFixed:
    case JointType::kElastic:
      check(lower == -Joint::kInfinite && upper == Joint::kInfinite,
            "lower, upper: fixed and elastic joints have no limits");
      break;
    case JointType::kDistance:
      check(upper > 0, "upper: expected a distance above 0, got " + std::to_string(upper));
      break;
    case JointType::kBall:
      check((lower == -Joint::kInfinite || lower >= -std::numbers::pi) &&
                (upper == Joint::kInfinite || upper <= std::numbers::pi),
            "lower, upper: expected limits of the twist within -pi and pi");
      break;
    case JointType::kHinge:
    case JointType::kSlider:
    case JointType::kUniversal:
      break;
    default:
      check(false, "type: there is no such joint");
  }
  if (joint.cone == Joint::kInfinite) return;
  check(joint.type == JointType::kBall, "cone: only balls have one");
  check(joint.cone > 0 && joint.cone <= std::numbers::pi,
        "cone: expected an angle above 0 and not above pi, got " + std::to_string(joint.cone));
}

}  // namespace

Joint make_ball(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                const Vec3& axis) {
  return make(JointType::kBall, bodies, a, b, anchor, axis);
}
Joint make_hinge(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                 const Vec3& axis) {
  return make(JointType::kHinge, bodies, a, b, anchor, axis);
}
Joint make_slider(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                  const Vec3& axis) {
  return make(JointType::kSlider, bodies, a, b, anchor, axis);
}
Joint make_fixed(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor) {
  return make(JointType::kFixed, bodies, a, b, anchor, Vec3::UnitX());
}

Joint make_elastic(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                   const Vec3& axis) {
  return make(JointType::kElastic, bodies, a, b, anchor, axis);
}

Joint make_universal(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                     const Vec3& axis_a, const Vec3& axis_b) {
  const Vec3 n = unit(axis_a, "axis_a"), e = unit(axis_b, "axis_b");
  check(std::abs(n.dot(e)) < 1e-6, "axis_a, axis_b: expected axes at right angles");
  Mat3 axes;
  axes.col(0) = n;
  axes.col(1) = (e - n.dot(e) * n).normalized();
  axes.col(2) = n.cross(axes.col(1));
  return make(JointType::kUniversal, bodies, a, b, anchor, Quaternion(axes).normalized());
}

Joint make_distance(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& point_a,
                    const Vec3& point_b) {
  check_pair(bodies, a, b);
  check(point_a.allFinite(), "point_a: expected finite numbers");
  check(point_b.allFinite(), "point_b: expected finite numbers");
  Joint joint;
  joint.type = JointType::kDistance;
  joint.a = a, joint.b = b;
  joint.in_a = frame_in(bodies, a, point_a, Quaternion::Identity());
  joint.in_b = frame_in(bodies, b, point_b, Quaternion::Identity());
  joint.coordinate = joint.lower = joint.upper = (point_a - point_b).norm();
  return joint;
}

void check_joint(const Joint& joint, const Bodies& bodies) {
  check_numbers(bodies, joint.a, joint.b);
  const auto check_frame = [](const Joint::Frame& frame, const std::string& name) {
    check(frame.anchor.allFinite(), name + ".anchor: expected finite numbers");
    check(std::abs(frame.axes.norm() - 1) < 1e-6,
          name + ".axes: expected a quaternion of length 1");
  };
  check_frame(joint.in_a, "in_a");
  check_frame(joint.in_b, "in_b");
  check_limits(joint);
  check_motor(joint);
  check_spring(joint.spring);
  check(std::isfinite(joint.coordinate), "coordinate: expected a finite number");
  for (const double l : joint.impulse) check(std::isfinite(l), "impulse: expected finite numbers");
  check(joint.force.allFinite() && joint.torque.allFinite() && std::isfinite(joint.effort) &&
            std::isfinite(joint.length_error) && std::isfinite(joint.angle_error),
        "force, torque, effort, errors: expected finite numbers");
}

double joint_coordinate(const Joint& joint, const Bodies& bodies) {
  const auto all = joint_coordinates(joint, bodies);
  return all.empty() ? 0 : all[0];
}

std::vector<double> joint_coordinates(const Joint& joint, const Bodies& bodies) {
  const int row = coordinate_row(joint.type);
  if (row < 0) return {};
  JointLanes C[kJointRows];
  joint_values(joint.type, side_of(joint.in_a, joint.a, bodies),
               side_of(joint.in_b, joint.b, bodies), splat<JointLanes>(joint.coordinate), true, C);
  const int count = joint.type == JointType::kElastic     ? 3
                    : joint.type == JointType::kUniversal ? 2
                                                          : 1;
  std::vector<double> values;
  for (int k = 0; k < count; ++k) values.push_back(C[row + k][0]);
  return values;
}

Vec3 joint_axis(const Joint& joint, const Bodies& bodies) {
  const int row = coordinate_row(joint.type);
  if (row < 0) return Vec3::Zero();
  JointGradients G;
  joint_gradients(joint.type, side_of(joint.in_a, joint.a, bodies),
                  side_of(joint.in_b, joint.b, bodies), G);
  return first_lane(G.axis[row]).normalized();
}

double joint_gap(const Joint& joint, const Bodies& bodies) {
  JointLanes C[kJointRows];
  joint_values(joint.type, side_of(joint.in_a, joint.a, bodies),
               side_of(joint.in_b, joint.b, bodies), splat<JointLanes>(joint.coordinate), false, C);
  if (joint.type == JointType::kDistance)
    return std::max({0.0, joint.lower - C[0][0], C[0][0] - joint.upper});
  double gap = 0;
  for (int row = 0; row < joint_equations(joint.type); ++row)
    if (!is_turn(joint.type, row)) gap = std::hypot(gap, C[row][0]);
  return gap;
}

double joint_speed(const Joint& joint, const Bodies& bodies) {
  const int row = coordinate_row(joint.type);
  if (row < 0) return 0;
  JointGradients G;
  joint_gradients(joint.type, side_of(joint.in_a, joint.a, bodies),
                  side_of(joint.in_b, joint.b, bodies), G);
  const auto rate = [&](std::int32_t body, const JointVector& arm) -> Vec3 {
    if (body < 0) return Vec3::Zero();
    const Vec3 w = bodies.angular_velocity(body);
    if (is_turn(joint.type, row)) return w;
    return bodies.velocity(body) + w.cross(first_lane(arm));
  };
  return first_lane(G.axis[row]).dot(rate(joint.a, G.arm_a) - rate(joint.b, G.arm_b));
}

}  // namespace substep::rigid
