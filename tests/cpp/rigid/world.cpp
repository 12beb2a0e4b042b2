// A world: what is added and removed, who meets whom, who sleeps, and what fails.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <functional>
#include <limits>

#include "../core/failures.h"
#include "substep/core/errors.h"
#include "substep/core/interrupt.h"
#include "substep/core/quaternion.h"
#include "substep/core/usize.h"
#include "substep/rigid/world/queries.h"
#include "world_scene.h"

namespace {

using namespace substep;
using namespace substep::rigid;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

std::string message(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

// Of a half cylinder's worth: two boxes, one twice as dense.
TEST(RigidWorld, AssemblesFixturesAboutTheirCentre) {
  Fixture light = fixture_of(Box{{0.5, 0.5, 0.5}}), heavy = light;
  light.density = 1, heavy.density = 2;
  heavy.local.position = {1, 0, 0};
  std::vector<Fixture> fixtures{light, heavy};
  BodyState frame;
  frame.position = {5, 6, 7};
  frame.rotation = rotation_by({0, 0, M_PI / 2});
  const BodyState body = assemble(frame, fixtures);
  EXPECT_NEAR(body.mass, 3, 1e-12);
  EXPECT_LT((body.position - Vec3(5, 6 + 2. / 3, 7)).norm(), 1e-12);
  // I_yy = sum of m / 6 + m d^2
  EXPECT_NEAR(body.inertia.maxCoeff(), 3. / 6 + 4. / 9 + 2. / 9, 1e-12);
  World world;
  world.add(body, fixtures);
  EXPECT_LT((world.fixtures().pose(0).position - frame.position).norm(), 1e-12);
  EXPECT_LT((world.fixtures().pose(1).position - Vec3(5, 7, 7)).norm(), 1e-12);
}

TEST(RigidWorld, ChecksWhatIsAdded) {
  World world;
  const auto refused = [&](const Fixture& fixture, Motion motion, const char* part) {
    BodyState body;
    body.motion = motion;
    const std::string text = message([&] { world.add(body, {&fixture, 1}); });
    EXPECT_NE(text.find(part), std::string::npos) << text;
    EXPECT_EQ(world.bodies().size(), 0);
    EXPECT_EQ(world.fixtures().size(), 0);
  };
  const Motion dynamic = Motion::kDynamic;
  refused(fixture_of(Sphere{0}), dynamic, "fixture 0: radius");
  refused(fixture_of(Box{{1, kNan, 1}}), dynamic, "half_lengths");
  refused(fixture_of(Sphere{1}, -0.1), dynamic, "friction");
  refused(fixture_of(Sphere{1}, 0.5, 1.5), dynamic, "restitution");
  refused(fixture_of(Plane{Vec3::UnitZ(), 0}), dynamic, "only a static body");
  refused(fixture_of(Plane{{0, 0, 2}, 0}), Motion::kStatic, "normal");
  refused(fixture_of(std::shared_ptr<const ConvexHull>()), dynamic, "shape");
  WorldOptions options;
  options.contact.substeps = 0;
  EXPECT_THROW(World{options}, InputError);
  for (const double dt : {0., -1., kNan, std::numeric_limits<double>::infinity()})
    EXPECT_THROW(world.step(dt), InputError);
  const std::int64_t none[] = {0};
  EXPECT_THROW(world.remove(none), InputError);
  EXPECT_THROW(world.exclude(0, 1), InputError);
}

TEST(RigidWorld, FiltersAndExclusions) {
  World world;
  add_ground(world);
  Fixture ghost = fixture_of(Sphere{0.1});
  ghost.group = 2, ghost.mask = 2;
  add_body(world, ghost, {0, 0, 1});
  const std::int32_t ball = add_body(world, fixture_of(Sphere{0.1}), {1, 0, 1});
  const std::int32_t box = add_box(world, Vec3::Constant(0.2), {1, 0, 0.2});
  world.exclude(ball, box);
  advance(world, 2);
  EXPECT_LT(world.bodies().position(1).z(), -5);
  EXPECT_NEAR(world.bodies().position(ball).z(), 0.1, 1e-3);  // in the box
  EXPECT_NEAR(world.bodies().position(box).z(), 0.2, 1e-3);
  world.exclude(ball, box, false);
  advance(world, 2);
  EXPECT_GT((world.bodies().position(ball) - world.bodies().position(box)).norm(), 0.25);
}

// A plate that lifts a box, stops and sinks again; a box that sleeps on it wakes in time.
TEST(RigidWorld, KinematicBodiesCarry) {
  World world;
  const std::int32_t plate = add_body(world, fixture_of(Box{{1, 1, 0.1}}), {0, 0, 0}, 1,
                                      Quaternion::Identity(), Motion::kKinematic);
  const std::int32_t box = add_box(world, Vec3::Constant(0.2), {0, 0, 0.3});
  advance(world, 2);
  EXPECT_TRUE(world.asleep(box));
  for (const double speed : {0.5, -0.5}) {
    world.bodies().set_velocity(plate, {0.2, 0, speed}, Vec3::Zero());
    advance(world, 1);
    EXPECT_FALSE(world.asleep(box));
    EXPECT_NEAR(world.bodies().velocity(box).z(), speed, 1e-2);
    EXPECT_NEAR(world.bodies().velocity(box).x(), 0.2, 1e-2);
    world.bodies().set_velocity(plate, Vec3::Zero(), Vec3::Zero());
    advance(world, 2);
    EXPECT_TRUE(world.asleep(box));
    EXPECT_LT(world.bodies().velocity(box).norm(), 1e-12);
  }
  EXPECT_NEAR(world.bodies().position(plate).x(), 0.4, 1e-12);
  EXPECT_NEAR(world.bodies().position(box).z(), 0.3, 2e-3);
}

TEST(RigidWorld, SleepsAndWakes) {
  const auto sleeper = [] {
    World world;
    add_ground(world);
    add_box(world, Vec3::Constant(0.5), {0, 0, 0.5});
    add_box(world, Vec3::Constant(0.5), {0, 0, 1.5});
    add_box(world, Vec3::Constant(0.5), {5, 0, 0.5});
    advance(world, 2);
    for (int b = 1; b <= 3; ++b) EXPECT_TRUE(world.asleep(b));
    EXPECT_EQ(energy(world), world.bodies().potential_energy(world.options().gravity));
    return world;
  };
  const auto expect_awake = [](World& world) {
    world.step(1. / 60);
    EXPECT_FALSE(world.asleep(1));
    EXPECT_FALSE(world.asleep(2));
    EXPECT_TRUE(world.asleep(3));
  };
  {
    World world = sleeper();
    const std::vector<double> x = world.bodies().x;
    advance(world, 1);
    EXPECT_EQ(world.bodies().x, x);
    world.wake(2);
    expect_awake(world);
    advance(world, 1);
    EXPECT_TRUE(world.asleep(1));
  }
  {
    World world = sleeper();
    world.bodies().apply_force(2, {1, 0, 0}, world.bodies().position(2));
    expect_awake(world);
  }
  {
    World world = sleeper();
    world.bodies().apply_impulse(1, {1, 0, 0}, world.bodies().position(1));
    expect_awake(world);
  }
  {
    World world = sleeper();
    world.bodies().x[3] += 1;
    expect_awake(world);
  }
  {
    World world = sleeper();
    const std::int64_t removed[] = {1};
    world.remove(removed);
    EXPECT_FALSE(world.asleep(1));
    EXPECT_TRUE(world.asleep(2));
    advance(world, 2);
    EXPECT_NEAR(world.bodies().position(1).z(), 0.5, 2e-3);
  }
  {
    World world = sleeper();  // a body falls onto it
    add_body(world, fixture_of(Sphere{0.2}), {0, 0, 2.3});
    world.step(1. / 60);
    EXPECT_TRUE(world.asleep(2));
    advance(world, 0.2);
    EXPECT_FALSE(world.asleep(2));
  }
  {
    World world = sleeper();  // the ground is moved
    world.bodies().x[2] -= 0.1;
    world.step(1. / 60);
    for (int b = 1; b <= 3; ++b) EXPECT_FALSE(world.asleep(b));
    advance(world, 2);
    EXPECT_NEAR(world.bodies().position(3).z(), 0.4, 2e-3);
  }
}

// What only begins to slide does not fall asleep.
TEST(RigidWorld, SlowMotionDoesNotSleep) {
  World world(sloped(std::atan(0.5) + 0.02 * M_PI / 180));
  add_ground(world);
  const std::int32_t box = add_box(world, {0.5, 0.5, 0.25}, {0, 0, 0.25});
  advance(world, 4);
  EXPECT_FALSE(world.asleep(box));
  EXPECT_GT(world.bodies().velocity(box).x(), 0.01);
}

TEST(RigidWorld, MotionChanges) {
  World world;
  add_ground(world);
  const std::int32_t box = add_box(world, Vec3::Constant(0.5), {0, 0, 3});
  world.set_motion(box, Motion::kStatic);
  advance(world, 1);
  EXPECT_EQ(world.bodies().position(box).z(), 3);
  EXPECT_THROW(world.set_motion(box, Motion::kDynamic, -1), InputError);
  EXPECT_THROW(world.set_motion(0, Motion::kDynamic), InputError);
  world.set_motion(box, Motion::kDynamic, 2, Vec3::Constant(1. / 3));
  advance(world, 3);
  EXPECT_NEAR(world.bodies().position(box).z(), 0.5, 2e-3);
}

// A world without the removed body goes on the same.
TEST(RigidWorld, RemovalLeavesTheOthers) {
  const auto run = [](bool with) {
    World world;
    add_ground(world);
    if (with) add_box(world, Vec3::Constant(0.5), {20, 0, 0.5});
    for (int k = 0; k < 5; ++k) add_box(world, Vec3::Constant(0.5), {0.1 * k, 0, 0.5 + k});
    advance(world, 0.5);
    const std::int64_t removed[] = {1};
    if (with) {
      const auto numbers = world.remove(removed);
      EXPECT_EQ(numbers, (std::vector<std::int64_t>{0, -1, 1, 2, 3, 4, 5}));
    }
    advance(world, 1);
    return world.bodies();
  };
  const Bodies with = run(true), without = run(false);
  EXPECT_EQ(with.x, without.x);
  EXPECT_EQ(with.L, without.L);
}

TEST(RigidWorld, AddsAllOrNoneWhereMemoryStaysShort) {
  const Fixture fixture = fixture_of(Box{Vec3::Constant(0.5)});
  std::vector<BodyState> bodies(3);
  for (int k = 0; k < 3; ++k) bodies[usize(k)].position = {0.1 * k, 0, 1.6 + k};
  const auto after_half_a_second = [](World& world) {
    advance(world, 0.5);
    return world.bodies().x;
  };
  const auto make = [] {
    World world;
    add_ground(world);
    add_box(world, Vec3::Constant(0.5), {0, 0, 0.5});
    return world;
  };
  World few = make(), all = make();
  EXPECT_EQ(all.add(bodies, {&fixture, 1}), 2);
  const std::vector<double> of_few = after_half_a_second(few), of_all = after_half_a_second(all);
  int refused = 0;
  failures::at_each(&failures::fail_allocations_from, [&](const auto& call) {
    World world = make();
    call([&] { world.add(bodies, {&fixture, 1}); });
    const bool whole = world.bodies().size() == 5;
    EXPECT_TRUE(whole || world.bodies().size() == 2);
    refused += whole ? 0 : 1;
    World twin = world;
    EXPECT_EQ(after_half_a_second(twin), whole ? of_all : of_few);
    if (!whole) world.add(bodies, {&fixture, 1});
    EXPECT_EQ(after_half_a_second(world), of_all);
  });
  EXPECT_GT(refused, 10);
}

TEST(RigidWorld, JointsHoldAndGo) {
  World world;
  const std::int32_t bob = add_box(world, Vec3::Constant(0.1), {1, 0, 0});
  world.add_joint(make_ball(world.bodies(), bob, Joint::kWorld, Vec3::Zero()));
  advance(world, 1);
  EXPECT_NEAR(world.bodies().position(bob).norm(), 1, 1e-4);
  const std::int64_t first[] = {0};
  world.remove_joints(first);
  advance(world, 1);
  EXPECT_LT(world.bodies().position(bob).z(), -3);
  EXPECT_THROW(world.remove_joints(first), InputError);
}

TEST(RigidWorld, QueriesSeeWhereBodiesAre) {
  World world;
  add_ground(world);
  const std::int32_t box = add_box(world, Vec3::Constant(0.5), {0, 0, 3});
  const auto height = [&] {
    const auto hit = cast_ray(world.scene(), {{0, 0, 10}, {0, 0, -1}, 100});
    return hit ? 10 - hit->distance : kNan;
  };
  EXPECT_NEAR(height(), 3.5, 1e-12);
  advance(world, 0.3);
  EXPECT_NEAR(height(), world.bodies().position(box).z() + 0.5, 1e-12);
  world.bodies().x[5] = 6;
  EXPECT_NEAR(height(), 6.5, 1e-12);
}

// What fails leaves the world as it was.
TEST(RigidWorld, FailedStepsChangeNothing) {
  World world;
  add_ground(world);
  const std::int32_t box = add_box(world, Vec3::Constant(0.5), {0, 0, 0.5});
  const std::int32_t other = add_box(world, Vec3::Constant(0.5), {0, 0, 1.5});
  advance(world, 2);
  EXPECT_TRUE(world.asleep(box));
  const auto fails = [&](std::vector<double>& rows, std::size_t k, double value) {
    const double before = rows[k];
    rows[k] = value;
    const WorldState state = world.state();
    try {
      world.step(1. / 60);
      ADD_FAILURE() << value;
    } catch (const NonFiniteError& error) {
      EXPECT_EQ(error.index, other);
      EXPECT_NE(std::string(error.what()).find("body 2"), std::string::npos);
    }
    EXPECT_EQ(state.time, world.time);
    const WorldState after = world.state();
    EXPECT_EQ(after.bodies.P, state.bodies.P);
    EXPECT_EQ(std::memcmp(after.bodies.q.data(), state.bodies.q.data(), 12 * sizeof(double)), 0);
    EXPECT_EQ(after.island, state.island);
    EXPECT_EQ(after.slow_time, state.slow_time);
    EXPECT_EQ(after.contacts.size(), state.contacts.size());
    rows[k] = before;
  };
  Bodies& bodies = world.bodies();
  fails(bodies.P, 6, std::numeric_limits<double>::infinity());
  fails(bodies.force, 6, 1e300);
  bodies.clear_forces();
  fails(bodies.q, 8, kNan);
  World copy;
  copy.restore(world.state());
  advance(world, 0.5), advance(copy, 0.5);
  EXPECT_EQ(world.bodies().x, copy.bodies().x);
}

// An interrupt anywhere in a step leaves the state after the last whole step.
TEST(RigidWorld, InterruptsChangeNothing) {
  struct Stop {};
  World world;
  add_ground(world);
  for (int k = 0; k < 500; ++k)
    add_box(world, Vec3::Constant(0.1), {0.25 * (k % 10), 0.25 * (k / 10 % 10), 0.15 * (k / 100)});
  advance(world, 0.2);
  static int polls;
  for (int let = 0; let < 3; ++let) {
    polls = let;
    set_interrupt_hook([] {
      if (polls-- == 0) throw Stop{};
    });
    WorldState last = world.state();
    bool stopped = false;
    for (int k = 0; k < 1000000 && !stopped; ++k) {  // one poll in so many milliseconds
      try {
        world.step(1. / 60);
        last = world.state();
      } catch (const Stop&) {
        stopped = true;
      }
    }
    set_interrupt_hook(nullptr);
    ASSERT_TRUE(stopped);
    EXPECT_EQ(world.time, last.time);
    EXPECT_EQ(world.bodies().x, last.bodies.x);
    EXPECT_EQ(world.bodies().L, last.bodies.L);
    World copy;
    copy.restore(last);
    world.step(1. / 60), copy.step(1. / 60);
    EXPECT_EQ(world.bodies().x, copy.bodies().x);
  }
}

TEST(RigidWorld, HugeSpeedsAreFiniteOrRefused) {
  for (const double speed : {1e3, 1e6, 1e12, 1e100, 1e200}) {
    World world;
    add_ground(world);
    add_box(world, Vec3::Constant(0.5), {0, 0, 2});
    world.bodies().set_velocity(1, {speed, 0, -speed}, {speed, speed, 0});
    try {
      advance(world, 0.2);
    } catch (const NonFiniteError& error) {
      EXPECT_EQ(error.index, 1);
    }
    for (const double x : world.bodies().x) EXPECT_TRUE(std::isfinite(x)) << speed;
    for (const double L : world.bodies().L) EXPECT_TRUE(std::isfinite(L)) << speed;
  }
  for (const double dt : {1e-300, 10., 1e6, 1e300}) {
    World world;
    add_ground(world);
    add_box(world, Vec3::Constant(0.5), {0, 0, 2});
    try {
      for (int k = 0; k < 3; ++k) world.step(dt);
    } catch (const NonFiniteError& error) {
      EXPECT_EQ(error.index, 1);
    }
    for (const double x : world.bodies().x) EXPECT_TRUE(std::isfinite(x)) << dt;
    EXPECT_GT(world.bodies().position(1).z(), 0) << dt;
  }
}

TEST(RigidWorld, CoincidentBoxesPart) {
  World world;
  add_ground(world);
  for (int k = 0; k < 100; ++k) add_box(world, Vec3::Constant(0.1), {0, 0, 0.1});
  double farthest = 0, fastest = 0;
  for (int step = 0; step < 240; ++step) {
    world.step(1. / 60);
    for (int b = 1; b <= 100; ++b) {
      farthest = std::max(farthest, world.bodies().position(b).norm());
      fastest = std::max(fastest, world.bodies().velocity(b).norm());
    }
  }
  EXPECT_LT(farthest, 5);
  EXPECT_LT(fastest, 10);
  EXPECT_LT(penetration(world), 0.005);
}

}  // namespace
