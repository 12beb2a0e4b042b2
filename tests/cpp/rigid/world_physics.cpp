// What a world does by itself, with the settings it has, against closed forms.
#include <gtest/gtest.h>

#include "substep/core/quaternion.h"
#include "substep/core/usize.h"
#include "world_scene.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::rigid;

constexpr double kDegree = M_PI / 180;
const double kCritical = std::atan(0.5);

TEST(RigidWorld, SlidesAboveTheAngleOfFriction) {
  const auto way = [](double angle, double from, double until) {
    World world(sloped(angle));
    add_ground(world);
    const std::int32_t box = add_box(world, {0.5, 0.5, 0.25}, {0, 0, 0.25});
    advance(world, from);
    const double x = world.bodies().position(box).x(), v = world.bodies().velocity(box).x();
    advance(world, until - from);
    return std::pair(world.bodies().position(box).x() - x, world.bodies().velocity(box).x() - v);
  };
  EXPECT_LT(std::abs(way(0.8 * kCritical, 0, 4).first), 1e-5);
  EXPECT_LT(std::abs(way(kCritical - 0.02 * kDegree, 2, 4).first), 1e-5);
  for (const double above : {0.02 * kDegree, 0.1}) {
    const double angle = kCritical + above;
    const double exact = 2 * g * (std::sin(angle) - 0.5 * std::cos(angle));
    EXPECT_NEAR(way(angle, 1, 3).second / exact, 1, 5e-4);
  }
}

TEST(RigidWorld, HeightsFollowRestitution) {
  for (const double dt : {1. / 1000, 1. / 240, 1. / 60}) {
    World world;
    add_ground(world, 0.5, 0.8);
    const std::int32_t ball = add_body(world, fixture_of(Sphere{0.5}), {0, 0, 5.5});
    double height = 5, last = 0, most = 1e9;
    int bounces = 0;
    for (int k = 0; k < std::lround(8 / dt) && bounces < 6; ++k) {
      world.step(dt);
      const double v = world.bodies().velocity(ball).z();
      const double z = world.bodies().position(ball).z() - 0.5;
      EXPECT_LT(z, most);
      const double top = z + 0.5 * v * v / g;
      if (last > 0 && v <= 0) {
        EXPECT_NEAR(top / height, 0.64, 1e-3);
        height = top;
        ++bounces;
      }
      if (last <= 0 && v > 0) most = 0.64 * height * (1 + 1e-9);
      last = v;
    }
    EXPECT_EQ(bounces, 6);
  }
}

TEST(RigidWorld, SpheresRoll) {
  World slope(sloped(0.3));
  add_ground(slope);
  const std::int32_t a = add_body(slope, fixture_of(Sphere{0.5}), {0, 0, 0.5});
  advance(slope, 1);
  const double before = slope.bodies().velocity(a).x();
  advance(slope, 1);
  EXPECT_NEAR((slope.bodies().velocity(a).x() - before) / (5. / 7 * g * std::sin(0.3)), 1, 1e-3);

  World plane;
  add_ground(plane);
  const std::int32_t b = add_body(plane, fixture_of(Sphere{0.5}), {0, 0, 0.5});
  plane.bodies().set_velocity(b, {7, 0, 0}, Vec3::Zero());
  advance(plane, 2);
  EXPECT_NEAR(plane.bodies().velocity(b).x() / 5, 1, 1e-3);
}

TEST(RigidWorld, CradlePassesOn) {
  WorldOptions options;
  options.gravity = Vec3::Zero();
  World world(options);
  for (int k = 0; k < 5; ++k)
    add_body(world, fixture_of(Sphere{0.5}, 0, 1), {k == 0 ? -1. : k, 0, 0});
  world.bodies().set_velocity(0, {1, 0, 0}, Vec3::Zero());
  advance(world, 3);
  for (int k = 0; k < 4; ++k) EXPECT_LT(std::abs(world.bodies().velocity(k).x()), 0.05);
  EXPECT_GT(world.bodies().velocity(4).x(), 0.98);
}

TEST(RigidWorld, StacksStand) {
  for (const int n : {10, 20}) {
    World world;
    add_ground(world);
    for (int k = 0; k < n; ++k) add_box(world, Vec3::Constant(0.5), {0, 0, 0.5 + k});
    double sunk = 0, drift = 0;
    for (int step = 0; step < 600; ++step) {
      world.step(1. / 60);
      for (int k = 1; k <= n; ++k) {
        const Vec3 x = world.bodies().position(k);
        sunk = std::max(sunk, k - 0.5 - x.z());
        drift = std::max(drift, std::hypot(x.x(), x.y()));
      }
    }
    EXPECT_LT(sunk, 0.001) << n;
    EXPECT_LT(drift, 1e-6) << n;
    for (int k = 1; k <= n; ++k) EXPECT_NEAR(world.bodies().position(k).z(), k - 0.5, 0.005);
    EXPECT_TRUE(world.asleep(1)) << n;
    RecordProperty("sunk_mm", std::to_string(1000 * sunk));
  }
}

TEST(RigidWorld, HoldsAThousandfoldMass) {
  World world;
  add_ground(world);
  add_box(world, Vec3::Constant(0.5), {0, 0, 0.5});
  add_box(world, Vec3::Constant(0.5), {0, 0, 1.5}, 1000);
  double deepest = 0;
  for (int step = 0; step < 600; ++step) {
    world.step(1. / 60);
    deepest = std::max(deepest, penetration(world));
  }
  EXPECT_LT(deepest, 0.01);
  EXPECT_NEAR(world.bodies().position(2).z(), 1.5, 0.01);
}

TEST(RigidWorld, PyramidStandsStill) {
  World world;
  add_ground(world);
  for (int row = 0; row < 20; ++row)
    for (int k = 0; k < 20 - row; ++k)
      add_box(world, Vec3::Constant(0.5), {1.05 * k + 0.525 * row, 0, 0.5 + row});
  const std::vector<double> x = world.bodies().x;
  advance(world, 5);
  double way = 0;
  for (std::int64_t b = 1; b < world.bodies().size(); ++b)
    way = std::max(way, (world.bodies().position(b) - Vec3(&x[3 * usize(b)])).norm());
  EXPECT_LT(way, 0.01);
  EXPECT_LT(penetration(world), 0.001);
  int asleep = 0;
  for (std::int64_t b = 1; b < world.bodies().size(); ++b) asleep += world.asleep(b) ? 1 : 0;
  EXPECT_EQ(asleep, 210);
  RecordProperty("way_mm", std::to_string(1000 * way));
}

// An asymmetric top, near its unstable axis.
TEST(RigidWorld, FreeTopKeepsItsEnergy) {
  for (const auto& [method, bound] :
       {std::pair(FreeRotation::kExact, 1e-9), {FreeRotation::kSplitting, 1e-5}}) {
    WorldOptions options;
    options.gravity = Vec3::Zero();
    options.contact.rotation = method;
    World world(options);
    BodyState top;
    top.inertia = {1, 2, 3};
    top.angular_velocity = {1e-3, 1, 1e-3};
    world.add(top, {});
    const double before = world.bodies().kinetic_energy();
    const std::vector<double> L = world.bodies().L;
    double drift = 0;
    for (int k = 0; k < 24000; ++k) {
      world.step(1. / 240);
      drift = std::max(drift, std::abs(world.bodies().kinetic_energy() / before - 1));
    }
    EXPECT_LT(drift, bound);
    EXPECT_EQ(world.bodies().L, L);
  }
}

}  // namespace
