#include "substep/geometry/particle_contact.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "substep/core/random.h"

namespace {

using namespace substep::geometry;
using substep::Point;

Vec3 random_vector(std::uint64_t i, std::uint64_t stream) {
  const auto a = substep::uniform2(7, i, stream), b = substep::uniform2(8, i, stream);
  return {2 * a[0] - 1, 2 * a[1] - 1, 2 * b[0] - 1};
}
template <class Real>
Vec3 vector(const Point<Real>& p) {
  return {p.x, p.y, p.z};
}
template <class Real>
Point<Real> point(const Vec3& v) {
  return {static_cast<Real>(v[0]), static_cast<Real>(v[1]), static_cast<Real>(v[2]), 0};
}

// A ball of 32^3 nodes.
Shape sampled_ball(double radius) {
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

struct Case {
  const char* name;
  Collider collider;
};
std::vector<Case> cases() {
  return {{"plane", {Plane{Vec3(1, 2, 2) / 3}, {0.1, 0, 0}}},
          {"floor", {Plane{{0, 0, 1}}, {0, 0, -0.2}}},
          {"ball", {Sphere{0.7}, {0, 0.1, 0}}},
          {"bowl", {Sphere{0.9}, {0, 0.1, 0}, true}},
          {"block", {Box{{0.5, 0.3, 0.05}}, {0.1, 0, 0}}},
          {"tank", {Box{{0.8, 0.9, 0.7}}, {0.1, 0, 0}, true}},
          {"sampled", {sampled_ball(0.6), {0, 0, 0.1}}},
          {"vessel", {sampled_ball(0.8), {0, 0, 0.1}, true}}};
}

template <class Real>
class ParticleContactOf : public testing::Test {};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(ParticleContactOf, Reals);

// Particles that are thrown about through moving, turning obstacles never end inside of one, nor on
// the other side of one.
TYPED_TEST(ParticleContactOf, NothingEntersWhateverTheSpeed) {
  using Real = TypeParam;
  constexpr int kParticles = 300;
  const Vec3 origin(100, -50, 25);
  for (const auto& [name, still] : cases()) {
    for (const double friction : {0.0, 0.4}) {
      Collider moving = still;
      moving.set_position(still.position() + origin);
      moving.friction = friction;
      moving.velocity = {3, -2, 5};
      moving.angular_velocity = {-2, 9, 4};
      const double margin = 0.02, h = 0.01;
      ParticleContact<Real> contact({moving}, origin, margin);
      std::vector<Point<Real>> x(kParticles);
      const std::vector<Real> mass{Real(0.5)};
      for (int i = 0; i < kParticles; ++i) x[i] = point<Real>(random_vector(i, 0));
      contact.begin_step(kParticles);
      contact.clear(x, mass);
      for (int step = 1; step <= 10; ++step) {
        const double speed = step < 5 ? 1 : 1e3;
        contact.begin_step(kParticles);
        contact.begin_substep(h);
        const auto start = x;
        for (int iteration = 0; iteration < 3; ++iteration) {
          for (int i = 0; i < kParticles; ++i) {
            x[i] = point<Real>(vector(x[i]) + speed * h * random_vector(i, 10 * step + iteration));
          }
          contact.project(start, x, mass);
          for (int i = 0; i < kParticles; ++i) {
            const double d = contact.colliders[0].signed_distance(vector(x[i]) + origin).value;
            ASSERT_GT(d, 0.2 * margin) << name << " particle " << i << " step " << step;
          }
        }
        contact.end_step();
      }
    }
  }
}

// A point that a wall 1 mm thick comes upon at 1000 m/s goes ahead of it.
TYPED_TEST(ParticleContactOf, AThinFastWallSweepsParticles) {
  using Real = TypeParam;
  Collider wall(Box{{0.0005, 5, 5}}, {-1, 0, 0});
  wall.velocity = {1000, 0, 0};
  ParticleContact<Real> contact({wall}, Vec3::Zero(), 0.01);
  std::vector<Point<Real>> x{{0, 0, 0, 0}};
  const auto start = x;
  const std::vector<Real> mass{Real(2)};
  contact.begin_step(1);
  contact.begin_substep(0.01);
  contact.project(start, x, mass);
  contact.end_step();
  EXPECT_NEAR(x[0].x, 9.0105, 1e-3);
  EXPECT_NEAR(contact.colliders[0].exchange().impulse[0], -2 * x[0].x / 0.01, 0.1);
}

// Coulomb: a particle pressed on a plane by D sticks while it would slide by up to friction D.
TYPED_TEST(ParticleContactOf, FrictionSticksBelowItsBoundAndIsThatAbove) {
  using Real = TypeParam;
  for (const Vec3& normal : {Vec3(0, 0, 1), Vec3(0, 0.6, 0.8)}) {
    Collider plane(Plane{normal}, Vec3::Zero());
    plane.friction = 0.5;
    const Vec3 tangent(1, 0, 0);
    for (const double slide : {0.0049, 0.0051, 0.02}) {
      ParticleContact<Real> contact({plane}, Vec3::Zero(), 0.1);
      const std::vector<Real> mass{Real(1)};
      std::vector<Point<Real>> x{point<Real>(0.1 * normal)};
      const auto start = x;
      contact.begin_step(1);
      contact.begin_substep(0.01);
      x[0] = point<Real>(0.09 * normal + slide * tangent);
      for (int iteration = 0; iteration < 3; ++iteration) contact.project(start, x, mass);
      contact.end_step();
      EXPECT_NEAR(x[0].x, std::max(slide - 0.005, 0.0), 1e-6);
      EXPECT_NEAR(normal.dot(vector(x[0])), 0.1, 1e-6);
      const Vec3 impulse = contact.colliders[0].exchange().impulse;
      EXPECT_NEAR(normal.dot(impulse), -1, 1e-4);
      EXPECT_NEAR(tangent.dot(impulse), std::min(slide, 0.005) / 0.01, 1e-4);
    }
  }
}

// A turning table carries what lies on it, and feels the torque.
TEST(ParticleContact, ATurningTableCarriesParticles) {
  Collider table(Plane{{0, 0, 1}}, Vec3::Zero());
  table.friction = 1;
  table.angular_velocity = {0, 0, 0.5};
  const double h = 0.01;
  ParticleContact<double> contact({table}, Vec3::Zero(), 0.01);
  std::vector<Point<double>> x{{0.3, 0, 0.01, 0}};
  const std::vector<double> mass{2};
  contact.begin_step(1);
  contact.begin_substep(h);
  const auto start = x;
  x[0].z -= 9.81 * h * h * 10;
  contact.project(start, x, mass);
  contact.end_step();
  EXPECT_NEAR(x[0].x, 0.3 * std::cos(0.5 * h), 1e-9);
  EXPECT_NEAR(x[0].y, 0.3 * std::sin(0.5 * h), 1e-9);
  EXPECT_NEAR(contact.colliders[0].exchange().torque[2], -2 * 0.3 * 0.3 * 0.5, 1e-4);
}

// A ball dropped from 1 m: each bounce reaches e^2 of the height before.
TYPED_TEST(ParticleContactOf, RestitutionGivesTheHeightOfTheBounce) {
  using Real = TypeParam;
  for (const double e : {1.0, 0.8, 0.5}) {
    Collider floor(Plane{{0, 0, 1}}, Vec3::Zero());
    floor.restitution = e;
    const double margin = 0.01, h = 1e-3, g = 9.81;
    ParticleContact<Real> contact({floor}, Vec3::Zero(), margin);
    std::vector<Point<Real>> x{{0, 0, Real(1 + margin), 0}}, v{{}};
    const std::vector<Real> mass{Real(1)};
    double top = 0, expected = 1;
    int bounces = 0;
    for (int step = 0; step < 3000 && bounces < 3; ++step) {
      const auto start = x;
      const auto v_start = v;
      contact.begin_step(1);
      contact.begin_substep(h);
      v[0].z -= static_cast<Real>(g * h);
      x[0].z += static_cast<Real>(h) * v[0].z;
      contact.project(start, x, mass);
      v[0].z = (x[0].z - start[0].z) / static_cast<Real>(h);
      contact.bounce(start, v_start, v, mass);
      contact.end_step();
      if (v_start[0].z > 0 && v[0].z <= 0) {
        top = x[0].z - margin;
        expected *= e * e;
        ++bounces;
        EXPECT_NEAR(top, expected, 0.002 * expected) << "e = " << e;
      }
    }
    EXPECT_EQ(bounces, 3);
  }
}

TEST(ParticleContact, TheSameBitsForAnyNumberOfThreads) {
  std::vector<Vec3> given;
  std::vector<std::vector<Point<float>>> ends;
  for (const int threads : {1, 3}) {
    Collider tank(Box{{0.9, 0.9, 0.9}}, Vec3::Zero(), true), ball(Sphere{0.4}, {0, 0, 0.2});
    tank.friction = 0.3;
    ball.angular_velocity = {1, 2, 3};
    ParticleContact<float> contact({tank, ball}, Vec3::Zero(), 0.02);
    contact.threads = threads;
    std::vector<Point<float>> x(20000);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = point<float>(random_vector(i, 1));
    const std::vector<float> mass{1.0f};
    contact.begin_step(static_cast<std::int64_t>(x.size()));
    contact.clear(x, mass);
    contact.begin_substep(0.01);
    const auto start = x;
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = point<float>(vector(x[i]) + 0.1 * random_vector(i, 2));
    }
    contact.project(start, x, mass);
    contact.end_step();
    for (const Collider& collider : contact.colliders) given.push_back(collider.exchange().impulse);
    ends.push_back(x);
  }
  EXPECT_EQ(given[0], given[2]);
  EXPECT_EQ(given[1], given[3]);
  EXPECT_EQ(0, std::memcmp(ends[0].data(), ends[1].data(), ends[0].size() * sizeof ends[0][0]));
}

TEST(ParticleContact, HeldParticlesPassThrough) {
  ParticleContact<float> contact({Collider(Plane{{0, 0, 1}}, Vec3::Zero())}, Vec3::Zero(), 0.1);
  std::vector<Point<float>> x{{0, 0, -1, 0}, {0, 0, -1, 0}};
  const auto start = x;
  const std::vector<float> mass{0.0f, 1.0f};
  contact.begin_step(2);
  contact.begin_substep(0.1);
  contact.project(start, x, mass);
  EXPECT_EQ(x[0].z, -1);
  EXPECT_EQ(x[1].z, 0.1f);
}

}  // namespace
