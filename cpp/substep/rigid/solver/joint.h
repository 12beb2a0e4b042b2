// A joint: what it leaves free of the motion of body a as seen from body b, or from the world.
//
// Each side has a frame that is fixed in its body: a point (the anchor) and axes, of which the
// first, n, is the axis of the joint. With the anchors p and their difference d = p_a - p_b:
//   ball      d = 0                                    three turns are free
//   hinge     d = 0, n_a = n_b                         the angle about n is free
//   slider    d along n_b, equal axes                  the translation n . d is free
//   fixed     d = 0, equal axes                        nothing is free
//   distance  |d|                                      see below
//   elastic   d = 0                                    three turns are free, with springs
//   universal d = 0, n_a . e_b1 = 0                    the angles about n_a and e_b1 are free
// The coordinate of a joint is the angle of a hinge (continuous over turns), the translation of a
// slider, the twist of a ball about its axes, the distance |d|, the angle of a about n_a of a
// universal joint (over turns). It is kept within [lower, upper] without restitution: a rod has
// both alike, a rope lower = 0. A motor acts along it.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "substep/rigid/motion/bodies.h"

namespace substep::rigid {

enum class JointType : std::uint8_t {
  kBall,
  kHinge,
  kSlider,
  kFixed,
  kDistance,
  kUniversal,
  kElastic
};

enum class MotorType : std::uint8_t {
  kNone,
  kSpeed,  // as much of the force as brings the coordinate's rate to the target
  kSpring  // force = stiffness (target - coordinate) - damping rate
};

struct Joint {
  static constexpr double kInfinite = std::numeric_limits<double>::infinity();
  static constexpr std::int32_t kWorld = -1;

  struct Frame {
    Vec3 anchor = Vec3::Zero();                // in the (principal) frame of the body [m]
    Quaternion axes = Quaternion::Identity();  // from axes of the joint to those of the body
    Vec3 axis() const { return axes * Vec3::UnitX(); }
  };
  struct Motor {
    MotorType type = MotorType::kNone;
    double target = 0;        // of the rate [rad/s], [m/s], or of the coordinate [rad], [m]
    double stiffness = 0;     // of a spring [N m/rad], [N/m]
    double damping = 0;       // of a spring [N m s/rad], [N s/m]
    double most = kInfinite;  // torque or force [N m], [N]
  };

  // Of an elastic joint, along the rotation vector of a as seen from b, in the axes of b: its part
  // along n is the twist, what is across the swing. torque = stiffness (rest - vector) - damping
  // rate
  struct Spring {
    Vec3 rest = Vec3::Zero();                         // [rad]
    double twist_stiffness = 0, swing_stiffness = 0;  // [N m/rad]
    double twist_damping = 0, swing_damping = 0;      // [N m s/rad]
  };

  JointType type = JointType::kBall;
  std::int32_t a = 0, b = kWorld;                // numbers of bodies; one of them is dynamic
  Frame in_a, in_b;                              // that of the world is in the world
  double lower = -kInfinite, upper = kInfinite;  // of the coordinate
  double cone = kInfinite;  // of a ball: largest angle between the axes n_a and n_b [rad]
  Motor motor;              // hinge, slider, distance, universal
  Spring spring;            // elastic
  bool collide = false;     // whether contacts between a and b remain

  // State: what the next step begins with.
  std::array<double, 6> impulse{};  // of the last sub-step, by rows (joint_rows.h)
  double coordinate = 0;            // at the end of the last step

  // Reports of the last step: what the joint does to a at its anchor, on average [N], [N m], and
  // how far it is from what it asks for at its end.
  Vec3 force = Vec3::Zero(), torque = Vec3::Zero();
  double effort = 0;  // the part of it that motor, spring and limits do along the coordinate
  double length_error = 0, angle_error = 0;  // [m], [rad]
};

// Joints between bodies as they are now; points and axes (of any length) in the world. The
// coordinate of what turns or slides is 0 now. InputError: no dynamic body, or see check_joint.
Joint make_ball(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                const Vec3& axis = Vec3::UnitX());
Joint make_hinge(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                 const Vec3& axis);
Joint make_slider(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                  const Vec3& axis);
Joint make_fixed(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor);
// A ball with springs, of no stiffness yet.
Joint make_elastic(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                   const Vec3& axis);
// A cross of two axes at right angles, one that turns in a and one that turns in b.
Joint make_universal(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& anchor,
                     const Vec3& axis_a, const Vec3& axis_b);
// A rod of the length between the points; set lower, upper or a motor for others.
Joint make_distance(const Bodies& bodies, std::int32_t a, std::int32_t b, const Vec3& point_a,
                    const Vec3& point_b);

// InputError, naming what is wrong: numbers of bodies that do not exist or are the same, a frame,
// limit or motor that is not finite where it must be, lower > upper, a negative distance,
// stiffness, damping or force, a cone not within (0, pi], what the type does not have. A joint none
// of whose bodies is dynamic any more rests.
void check_joint(const Joint& joint, const Bodies& bodies);

// The coordinate at the poses of the bodies, angles within half a turn of joint.coordinate.
double joint_coordinate(const Joint& joint, const Bodies& bodies);
// All of what is free and has a coordinate: of a universal joint the angles about n_a and e_b1, of
// an elastic one the rotation vector, of others the one, if there is one.
std::vector<double> joint_coordinates(const Joint& joint, const Bodies& bodies);
// The unit vector of the coordinate: of its rotation, or of its translation; 0 if there is none.
Vec3 joint_axis(const Joint& joint, const Bodies& bodies);
// How far the points that it holds together are apart, or the distance from its limits [m].
double joint_gap(const Joint& joint, const Bodies& bodies);
// The rate of the coordinate; 0 if there is none.
double joint_speed(const Joint& joint, const Bodies& bodies);

}  // namespace substep::rigid
