// Fast bodies never pass through others, bounce as slow ones do, and gain no energy.
#include <gtest/gtest.h>

#include "substep/core/quaternion.h"
#include "substep/core/random.h"
#include "world_scene.h"

namespace {

using namespace substep;
using namespace substep::rigid;

const Box kPlate{{5, 5, 0.005}};

WorldOptions weightless() {
  WorldOptions options;
  options.gravity = Vec3::Zero();
  return options;
}

TEST(RigidWorldFast, SphereDoesNotCrossAPlate) {
  for (const double restitution : {0., 0.5, 1.}) {
    for (const double angle : {0., 0.3, 0.8, 1.2}) {
      for (const double dt : {1. / 60, 1. / 240, 1. / 1000}) {
        for (std::uint64_t phase = 0; phase < 8; ++phase) {
          World world;
          add_body(world, fixture_of(kPlate), Vec3::Zero(), 1, Quaternion::Identity(),
                   Motion::kStatic);
          const double height = 0.2 + 3 * uniform2(1, phase)[0];
          const std::int32_t ball = add_body(world, fixture_of(Sphere{0.1}, 0.5, restitution),
                                             {-height * std::tan(angle), 0, height + 0.105});
          const Vec3 v = 1000 * Vec3(std::sin(angle), 0, -std::cos(angle));
          world.bodies().set_velocity(ball, v, Vec3::Zero());
          const double most = energy(world);
          for (int k = 0; k < 20; ++k) {
            world.step(dt);
            const Vec3 x = world.bodies().position(ball);
            if (x.x() > 5) break;
            EXPECT_GT(x.z(), 0.1) << angle << ' ' << dt;
            EXPECT_LE(energy(world), most * (1 + 1e-12));
          }
          const double up = world.bodies().velocity(ball).z();
          EXPECT_NEAR(up / -v.z(), restitution, 0.01) << angle << ' ' << dt;
        }
      }
    }
  }
}

// Every shape, turning, at plates, meshes and free bodies.
TEST(RigidWorldFast, NothingCrosses) {
  std::vector<Vec3> corners;
  for (int k = 0; k < 12; ++k)
    corners.emplace_back(0.1 * std::sin(2. * k), 0.1 * std::cos(3. * k),
                         0.1 * std::sin(5. * k + 1));
  const Shape shapes[] = {Sphere{0.1}, Box{{0.1, 0.15, 0.2}}, Capsule{0.05, 0.2},
                          Cylinder{0.1, 0.1}, std::make_shared<const ConvexHull>(corners)};
  const std::vector<Vec3> vertices{{-5, -5, 0}, {5, -5, 0}, {5, 5, 0}, {-5, 5, 0}};
  const std::vector<std::array<std::int32_t, 3>> faces{{0, 1, 2}, {0, 2, 3}};
  const Shape grounds[] = {kPlate, Plane{Vec3::UnitZ(), 0},
                           std::make_shared<const TriangleMesh>(vertices, faces)};
  for (const Shape& shape : shapes) {
    for (const Shape& ground : grounds) {
      for (std::uint64_t k = 0; k < 10; ++k) {
        const auto p = uniform2(2, k), q = uniform2(3, k);
        World world;
        add_body(world, fixture_of(ground), Vec3::Zero(), 1, Quaternion::Identity(),
                 Motion::kStatic);
        const std::int32_t body =
            add_body(world, fixture_of(shape, 0.5, k % 2 == 0 ? 0.5 : 0), {0, 0, 0.5 + 3 * p[0]}, 1,
                     rotation_by({3 * q[0], 2 * q[1], p[1]}));
        world.bodies().set_velocity(body, {20 * q[0], 20 * q[1], -200 - 800 * p[1]},
                                    {20 * p[0], 30 * q[0], 10});
        const double most = energy(world);
        for (int step = 0; step < 10; ++step) {
          world.step(1. / 60);
          const Vec3 x = world.bodies().position(body);
          if (std::hypot(x.x(), x.y()) > 4.5) break;
          EXPECT_GT(x.z(), 0) << shape.index() << ' ' << ground.index() << ' ' << k << ' ' << step;
          EXPECT_LE(energy(world), most * (1 + 1e-9))
              << shape.index() << ' ' << ground.index() << ' ' << k << ' ' << step;
        }
      }
    }
  }
}

// In a channel narrower than the way of a step: many bounces in each.
TEST(RigidWorldFast, StaysBetweenPlates) {
  World world(weightless());
  for (const double z : {-0.5, 0.5})
    add_body(world, fixture_of(kPlate), {0, 0, z}, 1, Quaternion::Identity(), Motion::kStatic);
  const std::int32_t ball = add_body(world, fixture_of(Sphere{0.1}, 0, 1), Vec3::Zero());
  world.bodies().set_velocity(ball, {1, 0, 700}, Vec3::Zero());
  for (int k = 0; k < 120; ++k) {
    world.step(1. / 60);
    EXPECT_LT(std::abs(world.bodies().position(ball).z()), 0.45);  // its middle
  }
  EXPECT_NEAR(world.bodies().velocity(ball).norm(), std::hypot(1, 700), 1e-6);
}

// Two free balls, off the line of their centres: the impulse is along the line at the impact.
TEST(RigidWorldFast, BallsMeetWhereTheyTouch) {
  World world(weightless());
  const std::int32_t a = add_body(world, fixture_of(Sphere{0.1}, 0, 1), {-3, 0, 0});
  const std::int32_t b = add_body(world, fixture_of(Sphere{0.1}, 0, 1), {3, 0.12, 0}, 2);
  world.bodies().set_velocity(a, {300, 0, 0}, Vec3::Zero());
  world.bodies().set_velocity(b, {-100, 0, 0}, Vec3::Zero());
  world.step(1. / 60);
  const Vec3 n(std::sqrt(0.04 - 0.12 * 0.12) / 0.2, 0.12 / 0.2, 0);
  const Vec3 impulse = 2 * (400 * n.x()) / (1 + 0.5) * n;
  EXPECT_LT((world.bodies().velocity(a) - (Vec3(300, 0, 0) - impulse)).norm(), 0.5);
  EXPECT_LT((world.bodies().velocity(b) - (Vec3(-100, 0, 0) + impulse / 2)).norm(), 0.5);
  EXPECT_NEAR(energy(world), 0.5 * 300 * 300 + 100 * 100, 1e-6);
}

// A pair that was thrown into each other flies on while it parts: as it turns deeper it may be held
// up in the first steps, not for ever.
TEST(RigidWorldFast, OverlappingBodiesFlyOn) {
  for (std::uint64_t k = 0; k < 200; ++k) {
    const auto p = uniform2(4, k), q = uniform2(5, k), r = uniform2(6, k);
    World world(weightless());
    const std::int32_t a = add_body(world, fixture_of(Cylinder{0.09, 0.09}), Vec3::Zero(), 1,
                                    rotation_by({3 * p[0], 3 * p[1], 0}));
    const std::int32_t b = add_body(world, fixture_of(Box{{0.1, 0.1, 0.1}}),
                                    {0, 0, 0.1 + 0.08 * q[0]}, 1, rotation_by({r[0], r[1], 0}));
    world.bodies().set_velocity(a, {6, 0, 0}, {30 * p[0], -30 * q[1], 0});
    world.bodies().set_velocity(b, {6, 0, -2}, {30 * r[0], 30 * r[1], 0});
    for (int step = 0; step < 10; ++step) {
      const double before = world.bodies().position(a).x() + world.bodies().position(b).x();
      world.step(1. / 60);
      const double way = world.bodies().position(a).x() + world.bodies().position(b).x() - before;
      EXPECT_GT(way, 0.1) << k << ' ' << step;
      if (step < 2) continue;
      EXPECT_NEAR(way, 12. / 60, 1e-6) << k << ' ' << step;
    }
  }
}

// What merely passes by is not met.
TEST(RigidWorldFast, PassesBy) {
  World world(weightless());
  add_body(world, fixture_of(kPlate), Vec3::Zero(), 1, Quaternion::Identity(), Motion::kStatic);
  const std::int32_t ball = add_body(world, fixture_of(Sphere{0.1}), {-8, 0, 1});
  world.bodies().set_velocity(ball, {500, 0, -40}, Vec3::Zero());
  world.step(1. / 60);
  EXPECT_NEAR(world.bodies().velocity(ball).x(), 500, 1e-9);
}

}  // namespace
