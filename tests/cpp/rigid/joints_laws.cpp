// Limits, motors and springs along the coordinates of joints.
#include <gtest/gtest.h>

#include "joint_scene.h"

namespace {

using namespace substep;
using namespace substep::rigid;
const Vec3 kHalf(0.3, 0.2, 0.1);
const double kMass = 3;
const double kMoment = kMass / 3 * (kHalf.x() * kHalf.x() + kHalf.y() * kHalf.y());  // about z

// A box that turns about a vertical axis through its centre.
JointScene turntable() {
  JointScene scene;
  scene.add_box(kHalf, Vec3::Zero(), kMass);
  scene.add(make_hinge(scene.bodies, 0, -1, Vec3::Zero(), Vec3::UnitZ()));
  return scene;
}

TEST(Joints, CarryTheWeightOfWhatHangs) {
  for (const int type : {0, 1, 2, 3, 4}) {
    JointScene scene;
    scene.add_box(kHalf, {1, 2, 3}, kMass);
    const Bodies& b = scene.bodies;
    const Vec3 anchor(1, 2, 4);
    scene.add(type == 0   ? make_ball(b, 0, -1, anchor)
              : type == 1 ? make_hinge(b, 0, -1, anchor, {1, 1, 0})
              : type == 2 ? make_slider(b, 0, -1, anchor, {1, 0, 0})
              : type == 3 ? make_fixed(b, 0, -1, anchor + Vec3(0.5, 0, 0))
                          : make_distance(b, 0, -1, anchor, anchor + Vec3::UnitZ()));
    for (int k = 0; k < 3; ++k) {  // from the first step on
      scene.step(1. / 60);
      EXPECT_LT((scene.joints[0].force - Vec3(0, 0, kMass * g)).norm(), 1e-9) << type;
      const Vec3 torque = type == 3 ? Vec3(0, 0.5 * kMass * g, 0) : Vec3::Zero();
      EXPECT_LT((scene.joints[0].torque - torque).norm(), 1e-9) << type;
    }
    EXPECT_LT((b.position(0) - Vec3(1, 2, 3)).norm(), 1e-9);
  }
}

TEST(Joints, SlideWithTheAccelerationOfTheIncline) {
  const double slope = 0.4;
  const Vec3 axis(std::cos(slope), 0, -std::sin(slope));
  JointScene scene;
  scene.add_box(kHalf, {0, 0, 1}, kMass);
  scene.add(make_slider(scene.bodies, 0, -1, {0.5, 0.3, 1}, axis));
  scene.advance(2);
  const double expected = g * std::sin(slope) * 2;  // t^2 / 2 = 2
  EXPECT_NEAR(scene.joints[0].coordinate, expected, 1e-9);
  EXPECT_LT((scene.bodies.position(0) - Vec3(0, 0, 1) - expected * axis).norm(), 1e-9);
  EXPECT_NEAR(scene.bodies.velocity(0).norm(), g * std::sin(slope) * 2, 1e-9);
  EXPECT_NEAR(scene.joints[0].force.norm(), kMass * g * std::cos(slope), 1e-7);
}

TEST(Joints, CountTheTurnsOfAHinge) {
  JointScene scene = turntable();
  scene.bodies.set_velocity(0, Vec3::Zero(), {0, 0, 12});
  scene.advance(10);
  EXPECT_NEAR(scene.joints[0].coordinate, 120, 1e-7);
  EXPECT_NEAR(joint_coordinate(scene.joints[0], scene.bodies), 120, 1e-7);
}

TEST(Joints, TurnByAMotorUpToItsSpeed) {
  JointScene scene = turntable();
  scene.joints[0].motor = {.type = MotorType::kSpeed, .target = 5, .most = 0.4};
  check_joint(scene.joints[0], scene.bodies);
  const double acceleration = 0.4 / kMoment;  // to 5 rad/s in 1.625 s
  scene.advance(1);
  EXPECT_NEAR(scene.bodies.angular_velocity(0).z(), acceleration, 1e-9);
  EXPECT_NEAR(scene.joints[0].coordinate, acceleration / 2, 1e-9);
  EXPECT_NEAR(scene.joints[0].torque.z(), 0.4, 1e-9);
  scene.advance(1);
  EXPECT_NEAR(scene.bodies.angular_velocity(0).z(), 5, 1e-9);
  EXPECT_NEAR(scene.joints[0].torque.z(), 0, 1e-9);

  // A load that it cannot hold stalls it: the rest of the torque turns it back.
  scene.joints[0].motor.most = 0.1;
  for (int k = 0; k < 60; ++k) {
    scene.bodies.torque[2] = -0.3;
    scene.step(1. / 60);
  }
  EXPECT_NEAR(scene.bodies.angular_velocity(0).z(), 5 - 0.2 / kMoment, 1e-9);
  EXPECT_NEAR(scene.joints[0].torque.z(), 0.1, 1e-9);
}

TEST(Joints, DriveASliderAgainstItsWeight) {
  JointScene scene;
  scene.add_box(kHalf, {0, 0, 1}, kMass);
  scene.add(make_slider(scene.bodies, 0, -1, {0, 0, 1}, Vec3::UnitZ()));
  scene.joints[0].motor = {.type = MotorType::kSpeed, .target = 0.5, .most = kMass * (g + 2)};
  scene.advance(0.2);
  EXPECT_NEAR(scene.bodies.velocity(0).z(), 0.4, 1e-9);  // 2 m/s^2 are left
  scene.advance(1);
  EXPECT_NEAR(scene.bodies.velocity(0).z(), 0.5, 1e-9);
  EXPECT_NEAR(scene.joints[0].force.z(), kMass * g, 1e-6);
}

TEST(Joints, StopAtLimitsWithoutBouncing) {
  // A slider falls on its limit and stays; a hinge swings to its own and is held there.
  JointScene scene;
  scene.add_box(kHalf, {0, 0, 1}, kMass);
  scene.add(make_slider(scene.bodies, 0, -1, {0, 0, 1}, Vec3::UnitZ()));
  scene.joints[0].lower = -0.4;
  scene.add_box(kHalf, {5, 0, 0}, kMass);
  scene.add(make_hinge(scene.bodies, 1, -1, {4.5, 0, 0}, Vec3::UnitY()));
  scene.joints[1].upper = 0.7;
  for (const Joint& joint : scene.joints) check_joint(joint, scene.bodies);
  double lowest = 0, furthest = 0;
  for (int k = 0; k < 240; ++k) {
    scene.step(1. / 60);
    lowest = std::min(lowest, scene.joints[0].coordinate);
    furthest = std::max(furthest, scene.joints[1].coordinate);
    if (k > 60) {
      EXPECT_NEAR(scene.joints[0].coordinate, -0.4, 1e-9);
      EXPECT_NEAR(scene.joints[1].coordinate, 0.7, 1e-9);
      EXPECT_NEAR(scene.joints[0].force.z(), kMass * g, 1e-6);
      EXPECT_LT(scene.bodies.velocity(0).norm() + scene.bodies.velocity(1).norm(), 1e-9);
    }
  }
  EXPECT_NEAR(lowest, -0.4, 1e-9);
  EXPECT_NEAR(furthest, 0.7, 1e-9);
  EXPECT_NEAR(scene.joints[1].torque.y(), -kMass * g * 0.5 * std::cos(0.7), 1e-6);
}

TEST(Joints, HoldLimitsAgainstMotors) {
  JointScene scene = turntable();
  scene.joints[0].upper = 8;  // more than a turn
  scene.joints[0].motor = {.type = MotorType::kSpeed, .target = 20, .most = 5};
  scene.advance(4);
  EXPECT_NEAR(scene.joints[0].coordinate, 8, 1e-9);
  EXPECT_NEAR(scene.joints[0].torque.z(), 0, 1e-7);  // of limit and motor together
  scene.joints[0].motor.target = -1;
  scene.advance(4);
  EXPECT_NEAR(scene.bodies.angular_velocity(0).z(), -1, 1e-9);
}

TEST(Joints, KeepBallsWithinTheirConeAndTwist) {
  JointScene scene;
  scene.add_box({0.05, 0.1, 0.5}, {0, 0, 0.5}, 2);
  scene.add(make_ball(scene.bodies, 0, -1, Vec3::Zero(), Vec3::UnitZ()));
  scene.joints[0].cone = 0.6;
  scene.joints[0].lower = -0.3, scene.joints[0].upper = 0.2;
  check_joint(scene.joints[0], scene.bodies);
  scene.bodies.set_velocity(0, {0.1, 0.05, 0}, {-0.1, 0.2, 1});
  scene.advance(10);
  EXPECT_LT(scene.angle_error, 1e-7);
  EXPECT_LT(scene.length_error, 1e-7);
  const Vec3 axis = scene.bodies.rotation(0) * Vec3::UnitZ();
  EXPECT_NEAR(std::acos(axis.z()), 0.6, 1e-6);  // it leans on the cone, and circles on it
}

TEST(Joints, TurnToATargetByADampedSpring) {
  JointScene scene = turntable();
  const double w = 8, ratio = 0.3;
  scene.joints[0].motor = {.type = MotorType::kSpring,
                           .target = 1,
                           .stiffness = kMoment * w * w,
                           .damping = 2 * ratio * kMoment * w};
  check_joint(scene.joints[0], scene.bodies);
  const double wd = w * std::sqrt(1 - ratio * ratio);
  for (int k = 1; k <= 60; ++k) {
    scene.step(1. / 60);
    const double t = k / 60.;
    const double exact =
        1 - std::exp(-ratio * w * t) * (std::cos(wd * t) + ratio * w / wd * std::sin(wd * t));
    EXPECT_NEAR(scene.joints[0].coordinate, exact, 3e-5);
  }
  // Not more than its most torque: it goes as a motor at its limit does.
  JointScene weak = turntable();
  weak.joints[0].motor = {.type = MotorType::kSpring, .target = 10, .stiffness = 1000, .most = 0.2};
  weak.advance(1);
  EXPECT_NEAR(weak.joints[0].coordinate, 0.2 / kMoment / 2, 1e-9);
}

TEST(Joints, HangAndTwistOnDampedSpringsAsFarAsTheLoadSays) {
  JointScene scene = turntable();
  scene.add_box(kHalf, {5, 0, 0}, kMass);
  scene.add(make_slider(scene.bodies, 1, -1, {5, 0, 0}, Vec3::UnitZ()));
  const double k = 100 * kMass, c = 15 * kMass, torque = 0.3;
  for (Joint& joint : scene.joints)
    joint.motor = {.type = MotorType::kSpring, .stiffness = k, .damping = c};
  for (int n = 0; n < 300; ++n) {
    Vec3::Map(scene.bodies.torque.data()) = torque * Vec3::UnitZ();
    scene.step(1. / 60);
  }
  EXPECT_NEAR(scene.joints[0].coordinate, torque / k, 1e-10);
  EXPECT_NEAR(scene.joints[1].coordinate, -kMass * g / k, 1e-10);
  EXPECT_NEAR(scene.bodies.angular_velocity(0).norm(), 0, 1e-10);
  EXPECT_NEAR(scene.bodies.velocity(1).norm(), 0, 1e-10);
}

TEST(Joints, SwingOnASpringWithItsFrequency) {
  JointScene scene;
  scene.add_box(kHalf, {0, 0, -1.2}, kMass);
  scene.add(make_distance(scene.bodies, 0, -1, {0, 0, -1.2}, Vec3::Zero()));
  const double w = 10, k = kMass * w * w;
  Joint& joint = scene.joints[0];
  joint.lower = 0, joint.upper = Joint::kInfinite;
  joint.motor = {.type = MotorType::kSpring, .target = 1, .stiffness = k};
  check_joint(joint, scene.bodies);
  const double rest = 1 + kMass * g / k, amplitude = 1.2 - rest;
  for (int n = 1; n <= 600; ++n) {
    scene.step(1. / 60);
    EXPECT_NEAR(joint.coordinate, rest + amplitude * std::cos(w * n / 60.), 1e-3 * 0.1 * 4);
  }
  const double energy = scene.energy() + k / 2 * std::pow(joint.coordinate - 1, 2);
  const double start = -kMass * g * 1.2 + k / 2 * 0.04;
  EXPECT_NEAR(energy, start, 1e-3 * k / 2 * amplitude * amplitude);  // without damping none is lost

  // However stiff, it is stable.
  joint.motor.stiffness = 1e9 * kMass;
  scene.advance(2);
  EXPECT_NEAR(joint.coordinate, 1, 0.1);
}

TEST(Joints, KeepRopesAndRodsAtTheirLength) {
  JointScene scene;
  scene.add_box(kHalf, {0.5, 0, 0}, kMass);
  scene.add(make_distance(scene.bodies, 0, -1, {0.5, 0, 0}, Vec3::Zero()));
  scene.joints[0].lower = 0, scene.joints[0].upper = 2;  // a rope that is slack
  scene.add_box(kHalf, {5, 0, 0}, kMass);
  scene.add(make_distance(scene.bodies, 1, -1, {5, 0, 0}, {6, 0, 0}));
  double longest = 0;
  for (int k = 0; k < 600; ++k) {
    scene.step(1. / 60);
    longest = std::max(longest, scene.joints[0].coordinate);
    if (k == 20) {
      EXPECT_NEAR(scene.joints[0].force.norm(), 0, 1e-12);  // still falls
      EXPECT_NEAR(scene.bodies.velocity(0).z(), -g * 21 / 60, 1e-9);
    }
    EXPECT_NEAR(scene.joints[1].coordinate, 1, 1e-9);
  }
  EXPECT_NEAR(longest, 2, 1e-9);
}

}  // namespace
