// Static and kinetic friction, and pairs of materials, against closed forms.
#include <gtest/gtest.h>

#include <cmath>

#include "substep/core/errors.h"
#include "world_scene.h"

namespace {

using namespace substep;
using namespace substep::rigid;

Fixture rubs(const Shape& shape, double kinetic, double sticks, std::string material = {}) {
  Fixture fixture = fixture_of(shape, kinetic);
  fixture.static_friction = sticks;
  fixture.material = std::move(material);
  return fixture;
}

// A block on a slope of this tangent that was pushed downhill, and its acceleration there.
double slides(double tangent, double speed, double dt) {
  World world(sloped(std::atan(tangent)));
  BodyState ground;
  ground.motion = Motion::kStatic;
  const Fixture plane = rubs(Plane{Vec3::UnitZ(), 0}, 0.4, 0.6);
  world.add(ground, {&plane, 1});
  const std::int32_t box = add_body(world, rubs(Box{{0.5, 0.5, 0.15}}, 0.4, 0.6), {0, 0, 0.15});
  world.bodies().set_velocity(box, {speed, 0, 0}, Vec3::Zero());
  advance(world, 0.5, dt);
  const double before = world.bodies().velocity(box).x();
  advance(world, 1, dt);
  return world.bodies().velocity(box).x() - before;
}

TEST(RigidFriction, SticksAndSlips) {
  const auto exact = [](double tangent) {
    return g * (tangent - 0.4) / std::hypot(1, tangent);  // g (sin - mu_k cos)
  };
  for (const double dt : {1. / 60, 1. / 240}) {
    EXPECT_NEAR(slides(0.599, 0, dt), 0, 1e-9);
    EXPECT_NEAR(slides(0.61, 0, dt) / exact(0.61), 1, 1e-3);
    EXPECT_NEAR(slides(0.5, 0.1, dt) / exact(0.5), 1, 1e-3);
    EXPECT_NEAR(slides(0.45, -0.2, dt), 0, 1e-9);
  }
}

TEST(RigidFriction, PairsOfMaterials) {
  World world;
  const auto add = [&](const char* material) {
    return add_body(world, rubs(Sphere{0.1}, 0.2, 0.3, material), {0, 0, 1});
  };
  add("a"), add("b");
  const auto surface = [&](int f, int h) {
    return world.fixtures().surface(world.fixtures()[f].fixture, world.fixtures()[h].fixture);
  };
  EXPECT_EQ(surface(0, 1).friction, std::sqrt(0.2 * 0.2));
  EXPECT_EQ(surface(0, 1).static_friction, std::sqrt(0.3 * 0.3));
  world.set_material_pair({.a = "b", .b = "a", .friction = 0.7, .rolling = 0.01});
  for (const auto& s : {surface(0, 1), surface(1, 0)}) {
    EXPECT_EQ(s.friction, 0.7);
    EXPECT_EQ(s.static_friction, 0.7);
    EXPECT_EQ(s.rolling, 0.01);
    EXPECT_EQ(s.restitution, 0);
  }
  EXPECT_EQ(surface(0, 0).friction, std::sqrt(0.2 * 0.2));
  world.set_material_pair({.a = "a", .b = "b", .restitution = 0.5});
  EXPECT_EQ(surface(0, 1).friction, std::sqrt(0.2 * 0.2));
  EXPECT_EQ(surface(0, 1).restitution, 0.5);

  World other;
  other.restore(world.state());
  ASSERT_EQ(other.material_pairs().size(), 1u);
  EXPECT_EQ(other.material_pairs()[0].a, "a");
  EXPECT_EQ(other.material_pairs()[0].restitution, 0.5);
  const MaterialPair wrong[] = {{.a = "a", .b = "c"},
                                {.a = "a", .b = ""},
                                {.a = "a", .b = "b", .friction = -1},
                                {.a = "a", .b = "b", .friction = 0.5, .static_friction = 0.4},
                                {.a = "a", .b = "b", .static_friction = 0.4},
                                {.a = "a", .b = "b", .restitution = 1.5},
                                {.a = "a", .b = "b", .spinning = INFINITY}};
  for (const MaterialPair& pair : wrong) EXPECT_THROW(world.set_material_pair(pair), InputError);
  EXPECT_EQ(surface(0, 1).restitution, 0.5);
  world.set_material_pair({.a = "a", .b = "b"});
  EXPECT_TRUE(world.material_pairs().empty());

  Fixture fixture = rubs(Sphere{0.1}, 0.5, 0.4);
  EXPECT_THROW(check_fixtures({&fixture, 1}, Motion::kDynamic), InputError);
}

}  // namespace
