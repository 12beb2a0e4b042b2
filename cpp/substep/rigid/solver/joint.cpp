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

Joint make(JointType type, const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
           const Vec3& axis) {
  check_pair(bodies, a, b);
  check(anchor.allFinite(), "anchor: expected finite numbers");
  const double largest = axis.cwiseAbs().maxCoeff();
  check(axis.allFinite() && largest > 0, "axis: expected finite numbers that are not all 0");
  const Quaternion axes = turn_of_x(axis / largest).normalized();
  Joint joint;
  joint.type = type;
  joint.a = a, joint.b = b;
  joint.in_a = frame_in(bodies, a, anchor, axes);
  joint.in_b = frame_in(bodies, b, anchor, axes);
  return joint;
}

void check_motor(const Joint& joint) {
  const Joint::Motor& motor = joint.motor;
  if (motor.type == MotorType::kNone) return;
  check(motor.type == MotorType::kSpeed || motor.type == MotorType::kSpring,
        "motor: there is no such kind");
  check(joint.type != JointType::kBall && joint.type != JointType::kFixed,
        "motor: only hinges, sliders and distance joints have one");
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

void check_limits(const Joint& joint) {
  const double lower = joint.lower, upper = joint.upper;
  check(lower <= upper, "lower, upper: expected lower <= upper, got " + std::to_string(lower) +
                            " and " + std::to_string(upper));
  check(lower < Joint::kInfinite && upper > -Joint::kInfinite,
        "lower, upper: expected limits that a finite number is within");
  switch (joint.type) {
    case JointType::kFixed:
      check(lower == -Joint::kInfinite && upper == Joint::kInfinite,
            "lower, upper: a fixed joint has no limits");
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
  check(std::isfinite(joint.coordinate), "coordinate: expected a finite number");
  for (const double l : joint.impulse) check(std::isfinite(l), "impulse: expected finite numbers");
  check(joint.force.allFinite() && joint.torque.allFinite() && std::isfinite(joint.length_error) &&
            std::isfinite(joint.angle_error),
        "force, torque, errors: expected finite numbers");
}

double joint_coordinate(const Joint& joint, const Bodies& bodies) {
  const auto side = [&](const Joint::Frame& frame, std::int32_t body) {
    return body < 0 ? JointSide(frame, Vec3::Zero(), Quaternion::Identity())
                    : JointSide(frame, bodies.position(body), bodies.rotation(body));
  };
  const int row = coordinate_row(joint.type);
  if (row < 0) return 0;
  return joint_values(joint.type, side(joint.in_a, joint.a), side(joint.in_b, joint.b),
                      joint.coordinate)[usize(row)];
}

}  // namespace substep::rigid
