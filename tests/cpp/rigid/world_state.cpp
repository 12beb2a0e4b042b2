// The same bits for any number of threads, through a state, and whatever happened elsewhere.
#include <gtest/gtest.h>

#include <functional>

#include "substep/core/errors.h"
#include "substep/core/quaternion.h"
#include "substep/core/random.h"
#include "world_scene.h"

namespace {

using namespace substep;
using namespace substep::rigid;

// Bodies of all shapes fall onto a mesh between walls; some bounce, some are compounds.
World pile(int n) {
  World world;
  add_ground(world);
  for (const double side : {-1., 1.}) {
    add_body(world, fixture_of(Box{{0.1, 2, 2}}), {1.1 * side, 0, 0}, 1, Quaternion::Identity(),
             Motion::kStatic);
    add_body(world, fixture_of(Box{{2, 0.1, 2}}), {0, 1.1 * side, 0}, 1, Quaternion::Identity(),
             Motion::kStatic);
  }
  const std::vector<Vec3> vertices{
      {-1, -1, 0.1}, {1, -1, 0.1}, {1, 1, 0.1}, {-1, 1, 0.1}, {0, 0, 0.3}};
  const std::vector<std::array<std::int32_t, 3>> faces{{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
  add_body(world, fixture_of(std::make_shared<const TriangleMesh>(vertices, faces)), Vec3::Zero(),
           1, Quaternion::Identity(), Motion::kStatic);
  std::vector<Vec3> corners;
  for (int k = 0; k < 10; ++k)
    corners.emplace_back(0.1 * std::sin(2. * k), 0.1 * std::cos(3. * k),
                         0.1 * std::sin(5. * k + 1));
  const Shape shapes[] = {Sphere{0.1},          Box{{0.1, 0.12, 0.08}},
                          Capsule{0.06, 0.1},   Cylinder{0.1, 0.08},
                          Box{{0.1, 0.1, 0.1}}, std::make_shared<const ConvexHull>(corners)};
  for (int k = 0; k < n; ++k) {
    const auto p = uniform2(1, static_cast<std::uint64_t>(k)),
               q = uniform2(2, static_cast<std::uint64_t>(k));
    const Vec3 x(1.4 * p[0] - 0.7, 1.4 * p[1] - 0.7, 0.6 + 0.1 * k);
    const Fixture fixture = fixture_of(shapes[k % 6], 0.5, k % 4 == 0 ? 0.4 : 0);
    const std::int32_t body = add_body(world, fixture, x, 1, rotation_by({q[0], q[1], p[0]}));
    world.bodies().set_velocity(body, {0, 0, k % 7 == 0 ? -30. : -2.}, {q[0], 5 * q[1], 0});
  }
  return world;
}

TEST(RigidWorldState, SameBitsForAnyThreads) {
  const auto run = [](int threads) {
    World world = pile(60);
    world.threads = threads;
    advance(world, 1.5);
    return world;
  };
  const World one = run(1);
  EXPECT_GT(one.contacts().size(), 100u);
  for (const int threads : {2, 3}) expect_same(one, run(threads));
}

TEST(RigidWorldState, GoesOnFromAState) {
  World world = pile(40);
  advance(world, 0.7);
  for (int round = 0; round < 4; ++round) {
    World other;
    other.restore(world.state());
    expect_same(world, other);
    for (int k = 0; k < 30; ++k) {
      world.step(1. / 60), other.step(1. / 60);
    }
    expect_same(world, other);
    advance(world, 0.5);
  }
}

// A pile in which bodies fall asleep and are woken, removed and moved.
TEST(RigidWorldState, SleepAndRemovalAreInTheState) {
  World world;
  add_ground(world);
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < 4; ++k) add_box(world, Vec3::Constant(0.5), {3. * i, 0, 0.5 + k});
  const std::int32_t plate = add_body(world, fixture_of(Box{{0.2, 3, 0.2}}), {-4, 0, 3}, 1,
                                      Quaternion::Identity(), Motion::kKinematic);
  world.bodies().set_velocity(plate, {1.5, 0, 0}, Vec3::Zero());
  std::vector<World> copies;
  int sleeping = 0;
  for (int step = 0; step < 300; ++step) {
    if (step % 60 == 20) {
      copies.emplace_back();
      copies.back().restore(world.state());
    }
    const std::int64_t removed[] = {step == 100 ? 9 : 14};
    for (std::size_t k = 0; k <= copies.size(); ++k) {
      World& w = k < copies.size() ? copies[k] : world;
      if (step == 100 || step == 200) w.remove(removed);
      if (step == 150) w.bodies().apply_impulse(7, {3, 1, 0}, w.bodies().position(7));
      w.step(1. / 60);
    }
    for (std::int64_t b = 0; b < world.bodies().size(); ++b) sleeping += world.asleep(b) ? 1 : 0;
    for (const World& copy : copies) ASSERT_EQ(copy.bodies().x, world.bodies().x) << step;
  }
  for (const World& copy : copies) expect_same(world, copy);
  EXPECT_GT(sleeping, 300);
}

// A body that comes near without touching changes nothing, nor does one far away.
TEST(RigidWorldState, OthersDoNotMatter) {
  const auto run = [](bool with) {
    World world;
    add_ground(world);
    for (int k = 0; k < 4; ++k) add_box(world, Vec3::Constant(0.5), {0.1 * k, 0.05 * k, 0.6 + k});
    if (with) {
      const std::int32_t by = add_body(world, fixture_of(Sphere{0.3}), {-9, 1.1, 40});
      world.bodies().set_velocity(by, {12, 0, -16}, Vec3::Zero());
    }
    advance(world, 1.2);
    std::vector<double> x(world.bodies().x.begin(), world.bodies().x.begin() + 15);
    return x;
  };
  EXPECT_EQ(run(true), run(false));
}

TEST(RigidWorldState, RefusesWhatDoesNotFit) {
  World world = pile(5);
  advance(world, 1);
  const WorldState good = world.state();
  const auto refuses = [&](const std::function<void(WorldState&)>& spoil) {
    WorldState bad = good;
    spoil(bad);
    EXPECT_THROW(world.restore(bad), InputError);
    EXPECT_EQ(world.bodies().x, good.bodies.x);
  };
  refuses([](WorldState& s) { s.bodies.q.pop_back(); });
  refuses([](WorldState& s) { s.fixture_body.back() = 100; });
  refuses([](WorldState& s) { s.island.pop_back(); });
  refuses([](WorldState& s) { s.island.back() = 99; });
  refuses([](WorldState& s) { s.excluded.push_back({0, 77}); });
  refuses([](WorldState& s) { s.contacts.front().fixture_a = 500; });
  refuses([](WorldState& s) { s.fixtures[6].friction = -1; });
}

}  // namespace
