// Worlds for tests.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "constants.h"
#include "substep/rigid/world/world.h"

namespace substep::rigid {

inline Fixture fixture_of(const Shape& shape, double friction = 0.5, double restitution = 0) {
  Fixture fixture;
  fixture.shape = shape;
  fixture.friction = friction;
  fixture.restitution = restitution;
  return fixture;
}

inline std::int32_t add_ground(World& world, double friction = 0.5, double restitution = 0) {
  BodyState body;
  body.motion = Motion::kStatic;
  const Fixture fixture = fixture_of(Plane{Vec3::UnitZ(), 0}, friction, restitution);
  return world.add(body, {&fixture, 1});
}

// A body of one fixture, of this mass if it is dynamic.
inline std::int32_t add_body(World& world, Fixture fixture, const Vec3& position, double mass = 1,
                             const Quaternion& rotation = Quaternion::Identity(),
                             Motion motion = Motion::kDynamic) {
  BodyState body;
  body.position = position;
  body.rotation = rotation;
  if (motion == Motion::kDynamic) {
    fixture.density = 1;
    body = assemble(body, {&fixture, 1});
    body.inertia *= mass / body.mass;
    body.mass = mass;
  }
  body.motion = motion;
  return world.add(body, {&fixture, 1});
}
inline std::int32_t add_box(World& world, const Vec3& half, const Vec3& position, double mass = 1) {
  return add_body(world, fixture_of(Box{half}), position, mass);
}

inline void advance(World& world, double duration, double dt = 1. / 60) {
  for (int k = 0; k < std::lround(duration / dt); ++k) world.step(dt);
}

// Deepest point of the contacts of the last step [m].
inline double penetration(const World& world) {
  double deepest = 0;
  for (const ContactConstraint& c : world.contacts())
    for (int k = 0; k < c.count; ++k) deepest = std::max(deepest, -c.points[k].separation);
  return deepest;
}

// That two worlds are the same to the last bit.
inline void expect_same(const World& p, const World& q) {
  EXPECT_EQ(p.time, q.time);
  EXPECT_EQ(p.bodies().x, q.bodies().x);
  EXPECT_EQ(p.bodies().q, q.bodies().q);
  EXPECT_EQ(p.bodies().P, q.bodies().P);
  EXPECT_EQ(p.bodies().L, q.bodies().L);
  const WorldState a = p.state(), b = q.state();
  EXPECT_EQ(a.slow_time, b.slow_time);
  EXPECT_EQ(a.island, b.island);
  EXPECT_EQ(a.rest_x, b.rest_x);
  ASSERT_EQ(a.contacts.size(), b.contacts.size());
  for (std::size_t k = 0; k < a.contacts.size(); ++k) {
    const ContactConstraint &c = a.contacts[k], &d = b.contacts[k];
    EXPECT_EQ(c.fixture_a, d.fixture_a);
    EXPECT_EQ(c.fixture_b, d.fixture_b);
    EXPECT_EQ(c.points[0].impulse, d.points[0].impulse);
  }
  ASSERT_EQ(a.joints.size(), b.joints.size());
  for (std::size_t k = 0; k < a.joints.size(); ++k) {
    const Joint &c = a.joints[k], &d = b.joints[k];
    EXPECT_EQ(c.impulse, d.impulse);
    EXPECT_EQ(c.coordinate, d.coordinate);
    EXPECT_EQ(c.force, d.force);
    EXPECT_EQ(c.torque, d.torque);
    EXPECT_EQ(c.length_error, d.length_error);
  }
}

inline double energy(const World& world) {
  return world.bodies().kinetic_energy() + world.bodies().potential_energy(world.options().gravity);
}

// The gravity that a slope of this angle [rad] sees, along x.
inline WorldOptions sloped(double angle) {
  WorldOptions options;
  options.gravity = 9.81 * Vec3(std::sin(angle), 0, -std::cos(angle));
  return options;
}

}  // namespace substep::rigid
