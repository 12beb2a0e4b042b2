// Joints and contacts together.
#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/usize.h"
#include "world_scene.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::rigid;

double joint_error(const World& world) {
  double worst = 0;
  for (const Joint& joint : world.joints())
    worst = std::max({worst, joint.length_error, joint.angle_error});
  return worst;
}

// A chain of hinges. (Of balls, a link that touches nothing may spin for ever about its two ends.)
TEST(Joints, LetAChainFallAndRest) {
  World world;
  add_ground(world);
  std::vector<std::int32_t> links;
  for (int k = 0; k < 12; ++k) {
    links.push_back(add_body(world, fixture_of(Box{{0.1, 0.05, 0.05}}), {0.2 * k, 0, 0.4 + 0.1 * k},
                             1, rotation_by({0, -0.3, 0})));
    if (k > 0)
      world.add_joint(make_hinge(world.bodies(), links[usize(k)], links[usize(k) - 1],
                                 {0.2 * k - 0.1, 0, 0.35 + 0.1 * k}, Vec3::UnitY()));
  }
  double worst = 0;
  for (int k = 0; k < 480; ++k) {
    world.step(1. / 60);
    worst = std::max(worst, joint_error(world));
  }
  EXPECT_LT(worst, 1e-4);
  EXPECT_LT(penetration(world), 1e-3);
  for (const std::int32_t link : links) {
    EXPECT_TRUE(world.asleep(link));
    EXPECT_LT(world.bodies().position(link).z(), 0.3);
  }
}

// On four driven wheels; the numbers of body and wheels are 1 to 5.
World cart(const Shape& wheel, const Quaternion& rotation) {
  World world;
  add_ground(world, 1);
  const std::int32_t body = add_box(world, {1, 0.4, 0.2}, {0, 0, 0.7}, 20);
  for (const double y : {-0.6, 0.6}) {
    for (const double x : {-0.8, 0.8}) {
      const std::int32_t number = add_body(world, fixture_of(wheel, 1), {x, y, 0.4}, 2, rotation);
      Joint joint = make_hinge(world.bodies(), number, body, {x, y, 0.4}, Vec3::UnitY());
      joint.motor = {.type = MotorType::kSpeed, .target = 5, .most = 10};
      world.add_joint(joint);
    }
  }
  return world;
}

TEST(Joints, DriveACart) {
  const Quaternion across(Eigen::AngleAxisd(std::numbers::pi / 2, Vec3::UnitX()));
  World on_spheres = cart(Sphere{0.4}, Quaternion::Identity());
  World on_wheels = cart(Cylinder{0.4, 0.05}, across);
  for (World* world : {&on_spheres, &on_wheels}) {
    double worst = 0, deepest = 0;
    for (int k = 0; k < 300; ++k) {
      world->step(1. / 60);
      worst = std::max(worst, joint_error(*world));
      deepest = std::max(deepest, penetration(*world));
    }
    EXPECT_LT(worst, 1e-6);
    EXPECT_LT(deepest, 1e-4);
    EXPECT_NEAR(world->bodies().velocity(1).x(), 2, 1e-6);
    for (const Joint& joint : world->joints()) EXPECT_NEAR(joint.torque.y(), 0, 1e-3);
    // 4 x 10 N m at 0.4 m start 28 kg and the wheels' own moments: 3.2 kg of spheres, 4 kg of
    // cylinders, in 0.624 s, 0.64 s.
    EXPECT_NEAR(world->joints()[3].coordinate, 5 * (5 - 0.632 / 2), 0.03);
  }
}

// A cart that drives, a body that swings on a spring, and one by itself, of number 7.
World cart_and_swing() {
  World world = cart(Sphere{0.4}, Quaternion::Identity());
  const std::int32_t bob = add_box(world, Vec3::Constant(0.2), {0, 5, 2}, 3);
  Joint spring = make_distance(world.bodies(), bob, Joint::kWorld, {0, 5, 2}, {0.5, 5, 3});
  spring.lower = 0, spring.upper = Joint::kInfinite;
  spring.motor = {.type = MotorType::kSpring, .target = 1, .stiffness = 200, .damping = 2};
  world.add_joint(spring);
  add_box(world, Vec3::Constant(0.2), {0, -5, 2});
  return world;
}

TEST(Joints, GoOnFromAState) {
  World world = cart_and_swing();
  for (int round = 0; round < 3; ++round) {
    advance(world, 0.25);
    World other = cart_and_swing();
    advance(other, 0.1);
    other.restore(world.state());
    expect_same(world, other);
    advance(world, 0.5), advance(other, 0.5);
    expect_same(world, other);
  }
}

TEST(Joints, AreAsTheyWereAfterAStepThatFails) {
  World world = cart_and_swing(), other = cart_and_swing();
  advance(world, 0.5), advance(other, 0.5);
  const Vec3 v = world.bodies().velocity(7), w = world.bodies().angular_velocity(7);
  other.bodies().set_velocity(7, v, w);
  world.bodies().set_velocity(7, {0, 0, 1e153}, w);
  const auto fails = [&] { world.step(1e3); };
  EXPECT_THROW(fails(), NonFiniteError);
  world.bodies().set_velocity(7, v, w);
  expect_same(world, other);
  advance(world, 0.5), advance(other, 0.5);
  expect_same(world, other);
}

TEST(Joints, AreAsTheyWereAfterAnInterrupt) {
  struct Stop {};
  static int polls;
  World world = cart_and_swing();
  for (int k = 0; k < 600; ++k)
    add_box(world, Vec3::Constant(0.1),
            {0.25 * (k % 10), 9 + 0.25 * (k / 10 % 10), 0.15 * (k / 100)});
  advance(world, 0.1);
  for (int let = 0; let < 6; ++let) {
    polls = let;
    set_interrupt_hook([] {
      if (polls-- == 0) throw Stop{};
    });
    World last;
    last.restore(world.state());
    bool stopped = false;
    while (!stopped) {
      try {
        world.step(1. / 60);
        last.restore(world.state());
      } catch (const Stop&) {
        stopped = true;
      }
    }
    set_interrupt_hook(nullptr);
    expect_same(world, last);
  }
}

TEST(Joints, CarryALoadThatIsLaidOnThem) {
  // A beam fixed at its end, of a fiftieth of the mass.
  World world;
  const std::int32_t beam = add_box(world, {0.5, 0.1, 0.05}, {0.5, 0, 1}, 1);
  world.add_joint(make_fixed(world.bodies(), beam, Joint::kWorld, {0, 0, 1}));
  const std::int32_t load = add_box(world, Vec3::Constant(0.1), {0.8, 0, 1.15}, 50);
  double worst = 0, deepest = 0;
  for (int k = 0; k < 240; ++k) {
    world.step(1. / 60);
    worst = std::max(worst, joint_error(world));
    deepest = std::max(deepest, penetration(world));
  }
  EXPECT_LT(worst, 1e-4);
  EXPECT_LT(deepest, 0.02);
  EXPECT_NEAR(world.bodies().position(load).z(), 1.15, 1e-3);
  EXPECT_NEAR(world.joints()[0].force.z(), 51 * g, 0.01 * 51 * g);
  EXPECT_NEAR(world.joints()[0].torque.y(), -(0.5 + 50 * 0.8) * g, 0.01 * 40 * g);
}

}  // namespace
