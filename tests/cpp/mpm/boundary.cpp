#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "plain.h"
#include "substep/core/random.h"

namespace {

using namespace substep::geometry;
using plain::Particle;
using plain::Simulation;
using substep::mpm::Boundary;
using substep::mpm::NodeCheck;

constexpr Boundary kBoundaries[] = {Boundary::kSticky, Boundary::kSlip, Boundary::kSeparate};

template <int D>
Vec3 random_vector(std::uint64_t i, std::uint64_t stream) {
  const auto a = substep::uniform2(7, i, stream), b = substep::uniform2(8, i, stream);
  return {2 * a[0] - 1, 2 * a[1] - 1, D == 3 ? 2 * b[0] - 1 : 0};
}

Shape ball_of_samples(double radius) {
  std::vector<double> values;
  for (int i = 0; i < 32; ++i) {
    for (int j = 0; j < 32; ++j) {
      for (int k = 0; k < 32; ++k) {
        values.push_back(0.1 * Vec3(i - 15.5, j - 15.5, k - 15.5).norm() - radius);
      }
    }
  }
  return std::make_shared<const SampledDistance>(std::array<std::int64_t, 3>{32, 32, 32},
                                                 Vec3(-1.55, -1.55, -1.55), 0.1, values);
}

struct Obstacle {
  const char* name;
  Collider collider;
};
// About the box |x_i| < 1. In two dimensions they are cut at z = 0, across their sides.
template <int D>
std::vector<Obstacle> cases() {
  const double z = D == 2 ? 0 : 0.1;
  std::vector<Obstacle> all{
      {"plane", {Plane{Vec3(2, 1, D == 2 ? 0 : 2).normalized()}, {0.1, 0, 0}}},
      {"ball", {Sphere{0.6}, {0, 0.1, z}}},
      {"bowl", {Sphere{0.9}, {0, 0.1, z}, true}},
      {"block", {Box{{0.5, 0.3, 0.8}}, {0.1, 0, z}}},
      {"plate", {Box{{0.004, 0.6, 2}}, {0.1, 0, z}}},
      {"tank", {Box{{0.8, 0.9, 0.7}}, {0.1, 0, z}, true}},
      {"sampled", {ball_of_samples(0.6), {0, 0, z}}},
      {"vessel", {ball_of_samples(0.8), {0, 0, z}, true}}};
  return all;
}

template <class Real_, int kDimension>
struct Kind {
  using Real = Real_;
  static constexpr int D = kDimension;
};
template <class K>
class MpmBoundary : public testing::Test {};
using Kinds = testing::Types<Kind<float, 2>, Kind<float, 3>, Kind<double, 2>, Kind<double, 3>>;
TYPED_TEST_SUITE(MpmBoundary, Kinds);

// Every shape, every condition, at rest and on the move: particles that fly about at nine tenths of
// a cell per step, ten times what a scene usually has, are never found in an obstacle.
TYPED_TEST(MpmBoundary, NothingEntersWhateverTheSpeed) {
  constexpr int D = TypeParam::D;
  const double cell = 0.2, dt = 0.02, fastest = 0.9 * cell / dt;
  for (const auto& [name, still] : cases<D>()) {
    for (const Boundary boundary : kBoundaries) {
      for (const double motion : {0.0, 1.0}) {
        Collider collider = still;
        collider.friction = 0.3;
        collider.velocity = motion * Vec3(1.5, -1, D == 3 ? 2 : 0);
        collider.angular_velocity = motion * Vec3(0, 0, 4);
        Simulation<typename TypeParam::Real, D> run(cell, 3, {collider}, {boundary});
        run.volume = std::pow(cell, D) / 8;
        for (std::uint64_t i = 0; i < 400; ++i) {
          const Vec3 x = random_vector<D>(i, 0);
          if (collider.signed_distance(x).value > 1e-3) run.particles.push_back({x});
        }
        ASSERT_GT(run.particles.size(), 20u);
        for (std::uint64_t step = 1; step <= 12; ++step) {
          for (std::uint64_t i = 0; i < run.particles.size(); ++i) {
            Particle& p = run.particles[i];
            p.C.setZero();
            // All one way, there and back, so that averages over neighbours are fast too; then each
            // its own.
            const double way = step / 3 % 2 == 0 ? fastest : -fastest;
            p.v = way * random_vector<D>(step <= 8 ? 0 : i, 1 + step / 6);
          }
          run.step(dt);
          const Collider& now = run.grid.colliders[0];
          for (std::size_t i = 0; i < run.particles.size(); ++i) {
            ASSERT_GT(now.signed_distance(run.particles[i].x).value, 0)
                << name << " boundary " << static_cast<int>(boundary) << " motion " << motion
                << " step " << step << " particle " << i;
          }
          EXPECT_LE(run.excess, 0.02);
        }
      }
    }
  }
}

// A block of jelly of `size` cells, whose lowest particles are a quarter of a cell above z = 0 (y
// in two dimensions), 2^D to a cell.
template <class Real, int D>
void fill(Simulation<Real, D>& run, double cell, const std::array<int, 3>& size,
          const Vec3& velocity = Vec3::Zero()) {
  for (int i = 0; i < 2 * size[0]; ++i) {
    for (int j = 0; j < 2 * size[1]; ++j) {
      for (int k = 0; k < (D == 3 ? 2 * size[2] : 1); ++k) {
        Vec3 x = 0.5 * cell * (Vec3(i, j, k).array() + 0.5);
        x.template head<D - 1>() -= 0.5 * cell * Vec3(size[0], size[1], 0).template head<D - 1>();
        if constexpr (D == 2) x[2] = 0;
        run.particles.push_back({x, velocity});
      }
    }
  }
  run.volume = std::pow(0.5 * cell, D);
}
template <int D>
const Vec3 kUp = D == 3 ? Vec3::UnitZ() : Vec3::UnitY();

template <class Real, int D>
Vec3 momentum(const Simulation<Real, D>& run) {
  Vec3 sum = Vec3::Zero();
  for (const Particle& p : run.particles) sum += run.mass() * p.v;
  return sum;
}
// With the affine part: sum of m (x cross v + the axial vector of C dx^2 / 4).
template <class Real, int D>
Vec3 angular_momentum(const Simulation<Real, D>& run, double cell) {
  Vec3 sum = Vec3::Zero();
  for (const Particle& p : run.particles) {
    const Vec3 spin(p.C(2, 1) - p.C(1, 2), p.C(0, 2) - p.C(2, 0), p.C(1, 0) - p.C(0, 1));
    sum += run.mass() * (p.x.cross(p.v) + 0.25 * cell * cell * spin);
  }
  return sum;
}

// What the obstacles were given is what the material lost, less its weight: impulse and torque,
// step by step, on a floor and a ball that both move.
TYPED_TEST(MpmBoundary, ImpulseAndTorqueAreWhatTheMaterialLost) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1, dt = 1e-3;
  const double rounding = std::is_same_v<typename TypeParam::Real, float> ? 2e-6 : 1e-13;
  for (const Boundary boundary : kBoundaries) {
    Collider floor(Plane{kUp<D>}, Vec3(0.3, 0, 0)), ball(Sphere{0.3}, -0.28 * kUp<D>);
    floor.friction = ball.friction = 0.4;
    floor.velocity = {-1, 0, 0};
    ball.angular_velocity = {0, 0, 3};
    Simulation<typename TypeParam::Real, D> run(cell, 4, {floor, ball}, {boundary, boundary});
    run.gravity = -9.81 * kUp<D>;
    run.mu = run.lambda = 1e5;
    fill(run, cell, {4, 4, 4}, Vec3(2, 0, 0) - 3 * kUp<D>);
    for (Particle& p : run.particles) p.x += 0.4 * cell * kUp<D>;
    const double weight = run.mass() * static_cast<double>(run.particles.size());
    for (int step = 0; step < 20; ++step) {
      const Vec3 p = momentum(run), L = angular_momentum(run, cell);
      Vec3 centre = Vec3::Zero(), given = Vec3::Zero(), turned = Vec3::Zero();
      for (const Particle& particle : run.particles) centre += run.mass() * particle.x;
      const std::vector<Collider> before = run.grid.colliders;
      run.grid.clear_exchange();
      run.step(dt);
      for (std::size_t c = 0; c < 2; ++c) {
        const Exchange& part = run.grid.colliders[c].exchange();
        given += part.impulse;
        turned += part.torque + before[c].position().cross(part.impulse);
      }
      const Vec3 lost = p + weight * dt * run.gravity - momentum(run);
      EXPECT_LT((given - lost).norm(), rounding * weight * 10) << "step " << step;
      // Particles that were moved at the surface were so after the grid: not in this step's sum.
      if (step >= 3) continue;
      const Vec3 slowed = L + dt * centre.cross(run.gravity) - angular_momentum(run, cell);
      EXPECT_LT((turned - slowed).norm(), rounding * weight * 10) << "step " << step;
    }
    EXPECT_GT(run.grid.colliders[1].exchange().impulse.norm(), 1e-3 * weight * 9.81 * dt);
  }
}

// No particle crosses a plate of a twentieth of a cell that fills the section, still or coming.
TYPED_TEST(MpmBoundary, AThinPlateHoldsBackAtAnySpeed) {
  constexpr int D = TypeParam::D;
  const double cell = 0.2, dt = 0.02;
  for (const double speed : {0.0, 4.0, -4.0}) {
    Collider plate(Box{{0.005, 5, 5}}, {-0.2 * speed * dt / cell, 0, 0});
    plate.velocity = {speed, 0, 0};
    Simulation<typename TypeParam::Real, D> run(cell, 3, {plate}, {Boundary::kSeparate});
    run.volume = std::pow(cell, D) / 8;
    std::vector<int> side;
    for (std::uint64_t i = 0; i < 500; ++i) {
      const Vec3 x = 0.7 * random_vector<D>(i, 0);
      side.push_back(x[0] > run.grid.colliders[0].position()[0] ? 1 : -1);
      if (plate.signed_distance(x).value > 1e-3) run.particles.push_back({x});
    }
    side.clear();
    for (const Particle& p : run.particles) side.push_back(p.x[0] > plate.position()[0] ? 1 : -1);
    for (int step = 0; step < 10; ++step) {
      for (std::size_t i = 0; i < run.particles.size(); ++i) {
        run.particles[i].v = Vec3((step % 4 < 2 ? 8.0 : -8.0), 0, 0);
        run.particles[i].C.setZero();
      }
      run.step(dt);
      for (std::size_t i = 0; i < run.particles.size(); ++i) {
        const double ahead = run.particles[i].x[0] - run.grid.colliders[0].position()[0];
        ASSERT_GT(side[i] * ahead, 0.005) << "speed " << speed << " step " << step;
      }
    }
  }
}

// A collider put upon material does not fling it: it comes out by at most kPush cells a step.
TYPED_TEST(MpmBoundary, WhatIsInsideComesOutGently) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1;
  Simulation<typename TypeParam::Real, D> run(cell, 3, {Collider(Sphere{0.2}, {0, 0, 0})},
                                              {Boundary::kSeparate});
  run.volume = 1e-3;
  run.particles.push_back({Vec3(0.19, 0, 0)});
  for (int step = 0; step < 10; ++step) {
    const double before = run.particles[0].x[0];
    run.step(1e-3);
    EXPECT_LE(run.particles[0].x[0] - before, 0.0201 * cell);
  }
  EXPECT_NEAR(run.particles[0].x[0], 0.2 + 1e-3 * cell, 1e-6);
  EXPECT_EQ(run.grid.colliders[0].exchange().impulse.norm(), 0);
}

// The floor under jelly at rest carries its weight.
TYPED_TEST(MpmBoundary, AHeapAtRestWeighsOnItsFloor) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1, dt = 1e-3;
  for (const Boundary boundary : kBoundaries) {
    Simulation<typename TypeParam::Real, D> run(cell, 3, {Collider(Plane{kUp<D>}, {0, 0, 0})},
                                                {boundary});
    run.gravity = -9.81 * kUp<D>;
    run.mu = run.lambda = 2e5;
    fill(run, cell, {4, 4, 4});
    for (int step = 0; step < 400; ++step) {
      if (step == 200) run.grid.clear_exchange();
      run.step(dt);
      for (Particle& p : run.particles) p.v *= 0.98, p.C *= 0.98;
    }
    const double weight = 9.81 * run.mass() * static_cast<double>(run.particles.size());
    const double force = -run.grid.colliders[0].exchange().impulse.dot(kUp<D>) / (200 * dt);
    EXPECT_NEAR(force, weight, 0.01 * weight);
  }
}

// A block on an incline: one degree below atan(friction) it stays, one above it slides with
// g (sin a - friction cos a).
TYPED_TEST(MpmBoundary, ABlockSlidesBeyondTheAngleOfFriction) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1, dt = 5e-4, friction = 0.5;
  for (const double degrees : {-1.0, 1.0}) {
    const double angle = std::atan(friction) + degrees * std::numbers::pi / 180;
    Collider floor(Plane{kUp<D>}, {0, 0, 0});
    floor.friction = friction;
    Simulation<typename TypeParam::Real, D> run(cell, 2, {floor}, {Boundary::kSeparate});
    run.gravity = 9.81 * (std::sin(angle) * Vec3::UnitX() - std::cos(angle) * kUp<D>);
    run.mu = run.lambda = 1e6;
    fill(run, cell, {6, 2, 2});
    const auto speed = [&] {
      return momentum(run)[0] / run.mass() / static_cast<double>(run.particles.size());
    };
    // Gravity turns to its angle slowly, so that the block neither bounces nor swings.
    const Vec3 along = run.gravity[0] * Vec3::UnitX();
    run.gravity -= along;
    const auto advance = [&](int steps, double kept, const Vec3& more) {
      for (int step = 0; step < steps; ++step) {
        run.gravity += more / steps;
        run.step(dt);
        for (Particle& p : run.particles) p.v *= kept, p.C *= kept;
      }
    };
    advance(200, 0.97, Vec3::Zero());
    advance(400, 1, along);
    advance(100, 1, Vec3::Zero());
    const double began = speed();
    run.grid.clear_exchange();
    advance(500, 1, Vec3::Zero());
    const Vec3 given = run.grid.colliders[0].exchange().impulse;
    const double weight = run.mass() * static_cast<double>(run.particles.size()) * 9.81 * 500 * dt;
    const double slides = 9.81 * (std::sin(angle) - friction * std::cos(angle)) * 500 * dt;
    EXPECT_NEAR(-given.dot(kUp<D>), weight * std::cos(angle), 0.01 * weight);
    if (degrees < 0) {
      EXPECT_NEAR(given[0], weight * std::sin(angle), 0.01 * weight);
      EXPECT_LT(std::abs(speed()), 1e-3 * std::abs(slides));
    } else {
      EXPECT_NEAR(given[0], -friction * given.dot(kUp<D>), 1e-3 * weight);
      EXPECT_NEAR(speed() - began, slides, 0.05 * slides);
    }
  }
}

// A belt takes a block along: what slides gains friction g until it moves with the belt, and a
// sticky one takes it at once.
TYPED_TEST(MpmBoundary, AMovingFloorTakesABlockAlong) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1, dt = 5e-4, friction = 0.3, speed = 0.5;
  for (const Boundary boundary : {Boundary::kSticky, Boundary::kSeparate}) {
    Collider floor(Plane{kUp<D>}, {0, 0, 0});
    floor.friction = friction;
    floor.velocity = {speed, 0, 0};
    Simulation<typename TypeParam::Real, D> run(cell, 2, {floor}, {boundary});
    run.gravity = -9.81 * kUp<D>;
    run.mu = run.lambda = 1e6;
    fill(run, cell, {6, 2, 2});
    const auto moved = [&](int steps) {
      for (int step = 0; step < steps; ++step) run.step(dt);
      return momentum(run)[0] / run.mass() / static_cast<double>(run.particles.size());
    };
    const double early = moved(160), expected = friction * 9.81 * 160 * dt;
    if (boundary == Boundary::kSeparate) {
      EXPECT_NEAR(early, expected, 0.1 * expected);
    } else {
      EXPECT_GT(early, 1.5 * expected);
    }
    EXPECT_NEAR(moved(640), speed, 0.05 * speed);
  }
}

// Material may leave a wall that separates, not one where it slips or sticks.
TYPED_TEST(MpmBoundary, OnlyASeparatingWallLetsGo) {
  constexpr int D = TypeParam::D;
  for (const Boundary boundary : kBoundaries) {
    Simulation<typename TypeParam::Real, D> run(0.1, 2, {Collider(Plane{kUp<D>}, {0, 0, 0})},
                                                {boundary});
    fill(run, 0.1, {2, 2, 2}, 0.1 * kUp<D>);
    run.step(1e-3);
    const double given = run.grid.colliders[0].exchange().impulse.dot(kUp<D>);
    if (boundary == Boundary::kSeparate) {
      EXPECT_EQ(given, 0);
    } else {
      EXPECT_GT(given, 0.02 * run.mass());
    }
  }
}

// Nodes take the condition from the surface on, or from `reach` before it, and no further.
TYPED_TEST(MpmBoundary, NodesWithinReachTakeTheCondition) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1;
  for (const double reach : {0.0, 0.25}) {
    Simulation<typename TypeParam::Real, D> run(cell, 2, {Collider(Sphere{0.33}, {0, 0, 0})},
                                                {Boundary::kSticky}, reach);
    fill(run, cell, {6, 6, 6}, Vec3(1, 0, 0));
    run.step(1e-9);
    int held = 0;
    run.for_nodes([&](const Vec3& x, const Vec3& v) {
      const bool within = x.norm() < 0.33 + reach;
      held += within;
      EXPECT_NEAR(v[0], within ? 0 : 1, 1e-5) << x.transpose();
    });
    EXPECT_GT(held, 10);
  }
}

// In the narrow edge between two walls a node moves along both, or not at all.
TYPED_TEST(MpmBoundary, ANodeInAnEdgeEntersNeitherWall) {
  constexpr int D = TypeParam::D;
  const double narrow = std::numbers::pi / 6;
  const Vec3 n(std::sin(narrow), -std::cos(narrow), 0), up = Vec3::UnitY();
  Simulation<typename TypeParam::Real, D> run(
      0.1, 2, {Collider(Plane{up}, {0, 0.15, 0}), Collider(Plane{n}, {0, -0.15, 0})},
      {Boundary::kSeparate, Boundary::kSeparate});
  fill(run, 0.1, {4, 2, 2}, Vec3(-1, -2, D == 3 ? 0.5 : 0));
  run.step(1e-9);
  int held = 0;
  run.for_nodes([&](const Vec3& x, const Vec3& v) {
    if (x[1] > 0.15 || n.dot(x + 0.15 * up) > 0) return;
    ++held;
    EXPECT_GT(v[1], -1e-3);
    EXPECT_GT(v.dot(n), -1e-3);
    EXPECT_NEAR(v[2], D == 3 ? 0.5 : 0, 1e-6);
  });
  EXPECT_GT(held, 3);
}

// The walls of a tank act one by one: in its corner, too, material only comes away from them.
TYPED_TEST(MpmBoundary, ACornerOfATankHoldsBothWays) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1;
  Collider tank(Box{{0.4, 0.4, 0.4}}, {0.2, 0.2, D == 3 ? 0.2 : 0}, true);
  Simulation<typename TypeParam::Real, D> run(cell, 2, {tank}, {Boundary::kSeparate});
  run.volume = std::pow(0.5 * cell, D);
  for (int i = 0; i < 64; ++i) {
    const Vec3 x = 0.05 * Vec3(i % 4 + 0.5, i / 4 % 4 + 0.5, D == 3 ? i / 16 + 0.5 : 0);
    run.particles.push_back({x - Vec3(0.2, 0.2, 0), Vec3(-3, -2, 0)});
  }
  for (int step = 0; step < 20; ++step) {
    run.step(1e-3);
    int held = 0;
    run.for_nodes([&](const Vec3& x, const Vec3& v) {
      if (x[0] > -0.2 + 1e-9 || x[1] > -0.2 + 1e-9) return;
      ++held;
      EXPECT_GT(v[0], -1e-6);
      EXPECT_GT(v[1], -1e-6);
    });
    EXPECT_GT(held, 0);
  }
  for (const Particle& p : run.particles) EXPECT_GT(tank.signed_distance(p.x).value, 0);
}

// The check of the nodes: the greatest speed, and the first that is not finite or too fast.
TYPED_TEST(MpmBoundary, TheFirstBadNodeIsFound) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1, dt = 1e-3;
  const auto check = [&](Boundary boundary, const Vec3& v, double bound) {
    Simulation<typename TypeParam::Real, D> run(cell, 2, {Collider(Plane{kUp<D>}, {0, 0, 0})},
                                                {boundary});
    fill(run, cell, {4, 4, 4}, Vec3(1, 0, 0));
    run.particles[5].v = v;
    return run.step(dt, bound);
  };
  const NodeCheck good = check(Boundary::kSeparate, {1, 0, 0}, 1e3);
  EXPECT_TRUE(good.good());
  EXPECT_NEAR(good.speed, 1, 1e-6);
  EXPECT_NEAR(good.reach, dt / cell, 1e-8);
  EXPECT_FALSE(check(Boundary::kSeparate, {1, 0, 0}, 0.5).good());
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Boundary boundary : kBoundaries) {  // also where a condition would hide it
    EXPECT_FALSE(check(boundary, {1, nan, 0}, 1e3).good());
    EXPECT_FALSE(check(boundary, {nan, 0, 0}, 1e3).good());
    EXPECT_FALSE(check(boundary, {std::numeric_limits<double>::infinity(), 0, 0}, 1e30).good());
  }
}

// The same bits for any number of threads.
TYPED_TEST(MpmBoundary, ThreadsDoNotChangeABit) {
  constexpr int D = TypeParam::D;
  const double cell = 0.1;
  std::vector<double> first;
  for (const int threads : {1, 2, 3}) {
    std::vector<Collider> colliders;
    for (auto& [name, collider] : cases<D>()) {
      if (collider.hollow() || std::string(name) == "block") continue;
      collider.friction = 0.3;
      collider.angular_velocity = {0, 0, 1};
      colliders.push_back(collider);
    }
    Simulation<typename TypeParam::Real, D> run(
        cell, 5, colliders, std::vector<Boundary>(colliders.size(), Boundary::kSeparate));
    run.threads = threads;
    run.volume = std::pow(cell, D) / 8;
    for (std::uint64_t i = 0; i < 300; ++i) {
      run.particles.push_back({random_vector<D>(i, 0), 4 * random_vector<D>(i, 1)});
    }
    for (int step = 0; step < 8; ++step) run.step(2e-3);
    std::vector<double> state;
    for (const Collider& collider : run.grid.colliders) {
      const auto numbers = collider.state();
      state.insert(state.end(), numbers.begin(), numbers.end());
    }
    for (const Particle& p : run.particles) state.insert(state.end(), p.x.data(), p.x.data() + 3);
    if (first.empty()) first = state;
    ASSERT_EQ(std::memcmp(first.data(), state.data(), first.size() * sizeof(double)), 0);
  }
}

}  // namespace
