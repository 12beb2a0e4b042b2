// Impacts with restitution, against closed forms.
#include <gtest/gtest.h>

#include "contact_scene.h"
#include "substep/core/random.h"

namespace {

using namespace substep;
using namespace substep::rigid;

// h_n = e^(2 n) h_0, whatever the step, and never above.
TEST(Impacts, HeightsFollowRestitution) {
  for (const double dt : {1. / 1000, 1. / 240, 1. / 60}) {
    ContactScene scene;
    scene.add_ground();
    const std::int32_t ball = scene.add_sphere(0.5, {0, 0, 5.5});
    scene.restitution[0] = 0.8;
    double height = 5, last = 0;
    int bounces = 0;
    for (int k = 0; k < std::lround(8 / dt) && bounces < 6; ++k) {
      scene.step(dt);
      const double v = scene.bodies.velocity(ball).z();
      const double top = scene.bodies.position(ball).z() - 0.5 + 0.5 * v * v / g;
      if (last > 0 && v <= 0) {
        EXPECT_NEAR(top / height, 0.64, 1e-10);
        height = top;
        ++bounces;
      }
      last = v;
    }
    EXPECT_EQ(bounces, 6);
  }
}

TEST(Impacts, ComeToRest) {
  ContactScene scene;
  scene.add_ground();
  scene.add_sphere(0.5, {0, 0, 1.5});
  scene.restitution[0] = 0.5;
  scene.advance(5);
  EXPECT_LT(scene.bodies.velocity(1).norm(), 1e-12);
  EXPECT_NEAR(scene.bodies.position(1).z(), 0.5, 2 * scene.options.slop);
}

// All four corners at once: no spin.
TEST(Impacts, FlatBoxBouncesFlat) {
  ContactScene scene;
  scene.add_ground();
  const std::int32_t box = scene.add_box(Vec3::Constant(0.5), {0, 0, 1.5});
  scene.restitution[0] = 0.5;
  double last = 0;
  for (int k = 0; k < 120 && !(last > 0 && scene.bodies.velocity(box).z() <= 0); ++k) {
    last = scene.bodies.velocity(box).z();
    scene.step(1. / 60);
  }
  const double v = scene.bodies.velocity(box).z();
  EXPECT_NEAR(scene.bodies.position(box).z() - 0.5 + 0.5 * v * v / g, 0.25, 1e-9);
  EXPECT_LT(scene.bodies.angular_velocity(box).norm(), 1e-9);
}

// j = -(1 + e) v.n / (1 / m + n . ((I^-1 (r x n)) x r)), without friction.
TEST(Impacts, CornerTakesItsImpulse) {
  ContactScene scene;
  scene.gravity = Vec3::Zero();
  scene.add_ground();
  const double e = 0.6, m = 2;
  const Vec3 half(0.5, 0.3, 0.2);
  const std::int32_t box = scene.add_box(half, Vec3::Zero(), m);
  scene.restitution[0] = e;
  scene.friction[0] = 0;
  const Quaternion q = rotation_by({0.5, 0.7, 0.2});
  store_quaternion(q, &scene.bodies.q[4]);
  Vec3 r = Vec3::Zero();
  for (int k = 0; k < 8; ++k) {
    const Vec3 corner(k & 1 ? half.x() : -half.x(), k & 2 ? half.y() : -half.y(),
                      k & 4 ? half.z() : -half.z());
    if ((q * corner).z() < r.z()) r = q * corner;
  }
  scene.bodies.x[5] = 0.001 - r.z();
  scene.bodies.set_velocity(box, {0.4, 0.1, -3}, Vec3::Zero());
  const Vec3 n = Vec3::UnitZ();
  const double mass = 1 / m + n.dot((scene.bodies.inverse_inertia(box) * r.cross(n)).cross(r));
  const double impulse = (1 + e) * 3 / mass;
  const Vec3 angular = impulse * r.cross(n);
  scene.step(1. / 240);
  EXPECT_NEAR(scene.bodies.velocity(box).z(), -3 + impulse / m, 1e-12);
  EXPECT_NEAR(scene.bodies.velocity(box).x(), 0.4, 1e-12);
  EXPECT_LT((Vec3(&scene.bodies.L[3]) - angular).norm(), 1e-12);
}

// Touching balls pass the velocity on, one after the other.
TEST(Impacts, CradlePassesOn) {
  ContactScene scene;
  scene.gravity = Vec3::Zero();
  for (int k = 0; k < 5; ++k) {
    scene.add_sphere(0.5, {k == 0 ? -1. : k, 0, 0});
    scene.restitution.back() = 1;
    scene.friction.back() = 0;
  }
  scene.bodies.set_velocity(0, {1, 0, 0}, Vec3::Zero());
  scene.advance(3);
  for (int k = 0; k < 4; ++k) EXPECT_NEAR(scene.bodies.velocity(k).x(), 0, 1e-12);
  EXPECT_NEAR(scene.bodies.velocity(4).x(), 1, 1e-12);
}

TEST(Impacts, NeverGainEnergyAndKeepMomentum) {
  ContactScene scene;
  scene.gravity = Vec3::Zero();
  for (std::uint64_t k = 0; k < 40; ++k) {
    const auto p = uniform2(1, k), q = uniform2(2, k);
    const auto layer = static_cast<double>(k % 4);
    const std::int32_t ball =
        scene.add_sphere(0.2, {2 * p[0], 2 * p[1], 0.5 * layer}, 1 + 4 * q[0]);
    scene.restitution.back() = 0.9;
    scene.bodies.set_velocity(ball, {4 * q[0] - 2, 4 * q[1] - 2, 1 - layer},
                              {5 * p[0], 3 * p[1], q[0]});
  }
  const Vec3 momentum = scene.bodies.momentum();
  std::int64_t impacts = 0;
  double energy = scene.energy();
  for (int k = 0; k < 120; ++k) {
    scene.step(1. / 60);
    impacts += scene.solver.impacts();
    EXPECT_LE(scene.energy(), energy * (1 + 1e-12));
    energy = scene.energy();
  }
  EXPECT_GT(impacts, 20);
  EXPECT_LT((scene.bodies.momentum() - momentum).norm(), 1e-12);
}

}  // namespace
