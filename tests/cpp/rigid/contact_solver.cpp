// Bodies that rest, slide, roll and stack, against closed forms.
#include <gtest/gtest.h>

#include "contact_scene.h"
#include "substep/core/random.h"

namespace {

using namespace substep;
using namespace substep::rigid;

constexpr double kDt = 1. / 60;

Vec3 along_slope(double angle) { return g * Vec3(std::sin(angle), 0, -std::cos(angle)); }

TEST(ContactSolver, CarriesTheWeight) {
  ContactScene scene;
  scene.add_ground();
  scene.add_box({0.5, 0.4, 0.3}, {0, 0, 0.3}, 3);
  scene.advance(2);
  double sum = 0;
  ASSERT_EQ(scene.contacts.size(), 1u);
  for (int k = 0; k < 4; ++k) sum += scene.contacts[0].points[k].impulse;
  EXPECT_NEAR(sum, 3 * g * kDt / scene.options.substeps, 1e-12);
  EXPECT_LT(scene.bodies.velocity(1).norm(), 1e-12);
}

TEST(ContactSolver, StacksNeitherDriftNorSink) {
  for (const int n : {10, 20}) {
    ContactScene scene;
    scene.add_ground();
    for (int k = 0; k < n; ++k) scene.add_box(Vec3::Constant(0.5), {0, 0, 0.5 + k});
    scene.advance(3);
    for (int k = 1; k <= n; ++k) {
      const Vec3 x = scene.bodies.position(k);
      EXPECT_LT(std::hypot(x.x(), x.y()), 1e-12);
      EXPECT_NEAR(x.z(), k - 0.5, 0.005);
    }
    EXPECT_LT(scene.penetration(), 2 * scene.options.slop);
  }
}

TEST(ContactSolver, WhatStandsComesToRest) {
  ContactScene scene;
  scene.add_ground();
  for (int row = 0; row < 8; ++row) {
    for (int k = 0; k < 8 - row; ++k)
      scene.add_box(Vec3::Constant(0.5), {1.05 * (k + 0.5 * row), 0, 0.5 + row});
  }
  scene.advance(1);
  const Vec3 mean(0, 1e-3 / 36, 0);
  for (int k = 1; k <= 36; ++k) scene.bodies.apply_impulse(k, mean * k, scene.bodies.position(k));
  scene.advance(2);
  for (int k = 1; k <= 36; ++k) EXPECT_LT(scene.bodies.velocity(k).norm(), 1e-6);
}

// Settling takes nothing from what moves: a box that is pushed up from where it stands.
TEST(ContactSolver, WhatIsPushedOffKeepsItsSpeed) {
  ContactScene scene;
  scene.add_ground();
  scene.add_box(Vec3::Constant(0.5), {0, 0, 0.5}, 2);
  scene.advance(1);
  scene.bodies.apply_impulse(1, {0, 0, 2}, scene.bodies.position(1));
  scene.step(kDt);
  EXPECT_NEAR(scene.bodies.velocity(1).z(), 1 - g * kDt, 1e-12);
  // Without friction nothing stands.
  scene.friction[0] = 0;
  scene.advance(1);
  scene.bodies.set_velocity(1, {1e-3, 0, 0}, Vec3::Zero());
  scene.advance(1);
  EXPECT_NEAR(scene.bodies.velocity(1).x(), 1e-3, 1e-12);
}

TEST(ContactSolver, HoldsAThousandfoldMass) {
  ContactScene scene;
  scene.add_ground();
  scene.add_box(Vec3::Constant(0.5), {0, 0, 0.5});
  scene.add_box(Vec3::Constant(0.5), {0, 0, 1.5}, 1000);
  scene.advance(10);
  EXPECT_LT(scene.penetration(), 0.01);
  EXPECT_NEAR(scene.bodies.position(2).z(), 1.5, 0.01);
}

TEST(ContactSolver, SlidesAboveTheAngleOfFriction) {
  const double critical = std::atan(0.5);
  const auto way = [&](double angle) {
    ContactScene scene;
    scene.gravity = along_slope(angle);
    scene.add_ground();
    scene.add_box({0.5, 0.5, 0.25}, {0, 0, 0.25});
    scene.advance(1);
    const double begin = scene.bodies.x[3], velocity = scene.bodies.velocity(1).x();
    scene.advance(2);
    return std::pair(scene.bodies.x[3] - begin, scene.bodies.velocity(1).x() - velocity);
  };
  EXPECT_LT(std::abs(way(0.8 * critical).first), 1e-12);
  EXPECT_LT(std::abs(way(critical - 0.02 * M_PI / 180).first), 1e-9);
  for (const double above : {0.02 * M_PI / 180, 0.1}) {
    const double angle = critical + above;
    const double exact = 2 * g * (std::sin(angle) - 0.5 * std::cos(angle));
    EXPECT_NEAR(way(angle).second / exact, 1, 1e-9);
  }
}

// Coulomb's cone is round: friction is opposite to the slip in every direction.
TEST(ContactSolver, FrictionDoesNotTurnTheSlip) {
  for (const double angle : {0.1, 0.6, 2.5}) {
    ContactScene scene;
    scene.add_ground();
    const std::int32_t box = scene.add_box({0.5, 0.3, 0.1}, {0, 0, 0.1});
    scene.bodies.set_velocity(box, {3 * std::cos(angle), 3 * std::sin(angle), 0}, Vec3::Zero());
    scene.advance(0.1);
    const double before = scene.bodies.velocity(box).norm();
    scene.advance(0.3);
    const Vec3 v = scene.bodies.velocity(box);
    EXPECT_NEAR(v.norm(), before - 0.5 * g * 0.3, 1e-9);
    EXPECT_NEAR(std::atan2(v.y(), v.x()), angle, 1e-6);
  }
}

TEST(ContactSolver, SpheresRoll) {
  ContactScene slope;
  slope.gravity = along_slope(0.3);
  slope.add_ground();
  slope.add_sphere(0.5, {0, 0, 0.5});
  slope.advance(1);
  const double before = slope.bodies.velocity(1).x();
  slope.advance(1);
  EXPECT_NEAR((slope.bodies.velocity(1).x() - before) / (5. / 7 * g * std::sin(0.3)), 1, 1e-6);

  ContactScene plane;
  plane.add_ground();
  plane.add_sphere(0.5, {0, 0, 0.5});
  plane.bodies.set_velocity(1, {7, 0, 0}, Vec3::Zero());
  plane.advance(2);  // it slips until 2 v / (7 mu g) = 0.41 s
  EXPECT_NEAR(plane.bodies.velocity(1).x(), 5, 1e-6);
  EXPECT_NEAR(plane.bodies.angular_velocity(1).y(), 10, 2e-6);
}

// The torque about the normal: mu m g d for a box on its corners, spinning m g for a sphere.
TEST(ContactSolver, SpinIsBraked) {
  ContactScene scene;
  scene.spinning = 0.01;
  scene.add_ground();
  scene.add_sphere(0.5, {0, 0, 0.5}, 2);
  scene.add_box({0.4, 0.4, 0.1}, {3, 0, 0.1}, 3);
  scene.advance(0.5);
  for (const int body : {1, 2}) scene.bodies.set_velocity(body, Vec3::Zero(), {0, 0, 9});
  scene.advance(0.5);
  const double sphere = 0.01 * g / (0.4 * 0.25);
  const double box = (0.5 * 0.4 * std::sqrt(2.) + 0.01) * g / (2 * 0.16 / 3);
  EXPECT_NEAR(scene.bodies.angular_velocity(1).z(), 9 - 0.5 * sphere, 1e-6);
  EXPECT_NEAR(scene.bodies.angular_velocity(2).z(), std::max(0., 9 - 0.5 * box), 1e-6);
}

// m a = -F, I a / r = F r - rolling m g, with I = 2 m r^2 / 5: a = -5/7 g rolling / r.
TEST(ContactSolver, RollingIsBraked) {
  const double r = 0.5, rolling = 0.01;
  ContactScene scene;
  scene.rolling = rolling;
  scene.add_ground();
  scene.add_sphere(r, {0, 0, r}, 2);
  scene.advance(0.5);
  scene.bodies.set_velocity(1, {3, 1, 0}, {-1 / r, 3 / r, 0});
  scene.advance(0.5);  // the warm start has turned to the new direction
  const Vec3 before = scene.bodies.velocity(1);
  scene.advance(1);
  const Vec3 v = scene.bodies.velocity(1);
  EXPECT_NEAR(before.norm() - v.norm(), 5. / 7 * g * rolling / r, 1e-6);
  EXPECT_LT(before.normalized().cross(v.normalized()).norm(), 1e-6);
  // On a slope it rolls above the angle of tan = rolling / r, and stays below.
  for (const double part : {0.9, 1.1}) {
    scene.bodies.set_velocity(1, Vec3::Zero(), Vec3::Zero());
    scene.gravity = along_slope(std::atan(part * rolling / r));
    scene.advance(0.5);
    const double start = scene.bodies.position(1).x();
    scene.advance(1);
    EXPECT_EQ(scene.bodies.position(1).x() - start > 1e-9, part > 1);
  }
}

// Those asleep carry others as static ones do, and are not touched.
TEST(ContactSolver, SleepingBodiesAreAsStatic) {
  ContactScene scene;
  scene.add_ground();
  for (int k = 0; k < 3; ++k) scene.add_box(Vec3::Constant(0.5), {0, 0, 0.5 + k});
  scene.advance(1);
  scene.find_contacts(kDt);
  scene.asleep = {0, 1, 1, 0};
  const Bodies before = scene.bodies;
  const double impulse = scene.contacts[0].points[0].impulse;
  scene.bodies.apply_impulse(3, {0.5, 0, 3}, scene.bodies.position(3));
  scene.advance(1);
  for (const int body : {1, 2}) {
    EXPECT_EQ(scene.bodies.position(body), before.position(body));
    EXPECT_EQ(scene.bodies.rotation(body).coeffs(), before.rotation(body).coeffs());
    EXPECT_EQ(scene.bodies.velocity(body), before.velocity(body));
  }
  EXPECT_EQ(scene.contacts[0].points[0].impulse, impulse);
  EXPECT_GT(scene.bodies.position(3).x(), 0.1);
  EXPECT_NEAR(scene.bodies.position(3).z(), 2.5, 1e-3);
}

TEST(ContactSolver, TellsWhatIsNotFinite) {
  ContactScene scene;
  scene.add_ground();
  scene.add_sphere(0.5, {0, 0, 0.49});
  scene.add_sphere(0.5, {5, 0, 0.49});
  scene.find_contacts(kDt);
  scene.bodies.force[3 * 2] = 1e300;
  const Bodies before = scene.bodies;
  EXPECT_EQ(scene.solver.step(scene.bodies, scene.gravity, kDt, scene.contacts, scene.options), 2);
  EXPECT_EQ(scene.bodies.x, before.x);
  EXPECT_EQ(scene.bodies.P, before.P);
  EXPECT_EQ(scene.contacts[0].points[0].impulse, 0);
}

TEST(ContactSolver, SolvesJointsInItsSweeps) {
  ContactScene scene;
  scene.add_ground();
  scene.add_box(Vec3::Constant(0.5), {0, 0, 2}, 4);
  scene.add_box(Vec3::Constant(0.5), {0, 0, 3}, 4);  // stands on the one that hangs
  scene.joints.push_back(make_fixed(scene.bodies, 1, -1, {0, 0, 2.5}));
  scene.advance(1);
  EXPECT_NEAR(scene.bodies.position(1).z(), 2, 1e-9);
  EXPECT_NEAR(scene.bodies.position(2).z(), 3, 1e-3);
  EXPECT_LT((scene.joints[0].force - Vec3(0, 0, 8 * g)).norm(), 1e-6);
}

TEST(ContactSolver, KeepsMomentum) {
  ContactScene scene;
  scene.gravity = Vec3::Zero();
  scene.add_box({0.5, 0.4, 0.3}, {0, 0, 0}, 2);
  scene.add_box({0.2, 0.3, 0.4}, {1.2, 0.3, 0.1}, 5);
  scene.bodies.set_velocity(0, {2, 0.3, 0}, {1, 2, 3});
  const Vec3 momentum = scene.bodies.momentum(), angular = scene.bodies.angular_momentum();
  scene.advance(1);
  EXPECT_GT(scene.bodies.velocity(1).norm(), 0.1);
  EXPECT_LT((scene.bodies.momentum() - momentum).norm(), 1e-13);
  // Impulses act where the points were at the start of the step.
  EXPECT_LT((scene.bodies.angular_momentum() - angular).norm(), 0.01 * angular.norm());
}

TEST(ContactSolver, OverlapIsTakenBackWithoutSpeed) {
  ContactScene scene;
  scene.gravity = Vec3::Zero();
  scene.add_box(Vec3::Constant(0.5), {0, 0, 0});
  scene.add_box(Vec3::Constant(0.5), {0, 0, 0.95});
  scene.advance(0.5);
  EXPECT_NEAR(scene.bodies.x[5] - scene.bodies.x[2], 1 - scene.options.slop, 1e-9);
  EXPECT_LT(scene.bodies.velocity(0).norm() + scene.bodies.velocity(1).norm(), 1e-12);
}

TEST(ContactSolver, SameBitsForAnyThreads) {
  const auto run = [](int threads) {
    ContactScene scene;
    scene.threads = threads;
    scene.add_ground();
    for (std::uint64_t k = 0; k < 180; ++k) {
      const double i = static_cast<double>(k % 6), j = static_cast<double>(k / 6 % 6),
                   layer = static_cast<double>(k / 36);
      scene.add_box(Vec3::Constant(0.1),
                    {0.205 * i + 0.01 * uniform2(3, k)[0], 0.205 * j, 0.1 + 0.2 * layer});
      scene.restitution.back() = k % 5 == 0 ? 0.5 : 0;
    }
    scene.advance(0.1);
    EXPECT_GT(scene.contacts.size(), 400u);  // enough to be shared out
    return scene.bodies;
  };
  const Bodies one = run(1);
  for (const int threads : {2, 3}) {
    const Bodies many = run(threads);
    EXPECT_EQ(one.x, many.x);
    EXPECT_EQ(one.q, many.q);
    EXPECT_EQ(one.P, many.P);
    EXPECT_EQ(one.L, many.L);
  }
}

// Points are found again by their place, whatever their order and number.
TEST(ContactConstraint, CarriesImpulsesToTheSamePoints) {
  Manifold manifold;
  manifold.normal = Vec3::UnitZ();
  const Vec3 corners[4] = {{1, 1, 0}, {-1, 1, 0}, {-1, -1, 0}, {1, -1, 0}};
  for (const Vec3& p : corners) manifold.add({p, p, 0, 0});
  ContactConstraint last = make_contact(manifold, 0, {}, 1, {});
  for (int k = 0; k < 4; ++k) last.points[k].impulse = k + 1;
  last.friction_impulse[0] = 7, last.twist_impulse = 8;

  // The upper body has slid by more than the distance of its corners, and the points turned.
  Manifold moved;
  moved.normal = Vec3::UnitZ();
  const Vec3 slide(3, 0.01, 0);
  for (const int k : {2, 3, 0}) moved.add({corners[k] + slide, corners[k] + slide, 0, 0});
  ContactConstraint now =
      make_contact(moved, 0, {}, 1, Pose(Vec3(3, 0, 0), Mat3(Mat3::Identity())));
  carry_impulses(last, now);
  EXPECT_EQ(now.points[0].impulse, 3);
  EXPECT_EQ(now.points[1].impulse, 4);
  EXPECT_EQ(now.points[2].impulse, 1);
  EXPECT_EQ(now.friction_impulse[0], 7);
  EXPECT_EQ(now.twist_impulse, 8);
  EXPECT_LT((now.tangent - last.tangent).norm(), 1e-15);

  // The upper body rolls, by more than the distance of its points, which so are others of both.
  const Vec3 roll(3, 0, 0);
  Manifold line, rolled;
  line.normal = rolled.normal = Vec3::UnitZ();
  for (const int k : {0, 3}) {
    line.add({corners[k], corners[k], 0, 0});
    rolled.add({corners[k] + roll, corners[k] + roll, 0, 0});
  }
  ContactConstraint before = make_contact(line, 0, {}, 1, Pose(Vec3(1, 0, 5), Mat3::Identity()));
  ContactConstraint after =
      make_contact(rolled, 0, {}, 1,
                   Pose(Vec3(4, 0, 5), Eigen::AngleAxisd(0.6, Vec3::UnitY()).toRotationMatrix()));
  for (int k = 0; k < 2; ++k) before.points[k].impulse = k + 1;
  carry_impulses(before, after);
  EXPECT_EQ(after.points[0].impulse, 1);
  EXPECT_EQ(after.points[1].impulse, 2);
}

}  // namespace
