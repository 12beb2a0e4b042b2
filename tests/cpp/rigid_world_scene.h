// Worlds for tests.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "substep/rigid/world.h"

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
