// What joints keep, and what they leave free: pendulums, tops, chains, compounds, momenta.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "joint_scene.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep;
using namespace substep::rigid;

// A rod of length 1 that hangs at its end, turned by an angle about y.
std::int32_t add_rod(JointScene& scene, double angle) {
  const Quaternion q = rotation_by({0, -angle, 0});
  return scene.add_box({0.02, 0.02, 0.5}, q * Vec3(0, 0, -0.5), 2, q);
}

struct Swing {
  double period, energy_error;  // the latter relative to what swings
};
Swing swing(JointScene& scene, double angle, double dt, double duration) {
  const double I = scene.bodies.inertia[1] + 2 * 0.25, start = scene.energy();
  const double swings = 2 * g * 0.5 * (1 - std::cos(angle));
  double first = -1, last = 0, before = angle, worst = 0;
  int halves = 0;
  for (int k = 1; k <= std::lround(duration / dt); ++k) {
    scene.step(dt);
    worst = std::max(worst, std::abs(scene.energy() - start) / swings);
    const Vec3 x = scene.bodies.position(0);
    const double now = std::atan2(x.x(), -x.z());
    if (before * now < 0) {
      last = (k - 1 + before / (before - now)) * dt;
      if (first < 0) first = last, halves = 0;
      ++halves;
    }
    before = now;
  }
  const double period = 2 * (last - first) / (halves - 1);
  // T = 4 sqrt(I / (m g l)) K(sin(angle / 2)).
  const double exact = 4 * std::sqrt(I / (2 * g * 0.5)) * std::comp_ellint_1(std::sin(angle / 2));
  return {period / exact - 1, worst};
}

TEST(Joints, SwingWithThePeriodOfThePhysicalPendulum) {
  for (const double degrees : {30., 90., 150.}) {
    for (const bool hinge : {false, true}) {
      const double angle = degrees * kPi / 180;
      JointScene scene;
      add_rod(scene, angle);
      scene.add(hinge ? make_hinge(scene.bodies, 0, -1, Vec3::Zero(), Vec3::UnitY())
                      : make_ball(scene.bodies, 0, -1, Vec3::Zero()));
      const Swing coarse = swing(scene, angle, 1. / 60, 60);
      EXPECT_LT(std::abs(coarse.period), 1e-5) << degrees;
      EXPECT_LT(coarse.energy_error, 3e-5) << degrees;
      EXPECT_LT(scene.length_error, 1e-9);
      EXPECT_LT(scene.angle_error, 1e-9);
    }
  }
}

TEST(Joints, ErrOfSecondOrder) {
  const double angle = kPi / 2;
  Swing last{};
  for (const int substeps : {1, 2, 4}) {
    JointScene scene;
    scene.options.substeps = substeps;
    add_rod(scene, angle);
    scene.add(make_ball(scene.bodies, 0, -1, Vec3::Zero()));
    const Swing now = swing(scene, angle, 1. / 60, 10);
    if (substeps > 1) {
      EXPECT_NEAR(last.period / now.period, 4, 0.2);
      EXPECT_NEAR(last.energy_error / now.energy_error, 4, 0.6);
    }
    last = now;
  }
}

// Steady precession of a top about its fixed point: I1 cos(th) O^2 - I3 w3 O + m g r = 0, I1 about
// that point.
TEST(Joints, PrecessAsTheHeavyTop) {
  const double m = 1, r = 0.1, I3 = 0.02, Ic = 0.015, I1 = Ic + m * r * r;
  for (const double w3 : {60., 200.}) {
    for (const double theta : {0.5, 1.2}) {
      const double A = I1 * std::cos(theta), B = I3 * w3;
      const double O = (B - std::sqrt(B * B - 4 * A * m * g * r)) / (2 * A);
      const Vec3 axis(std::sin(theta), 0, std::cos(theta));
      const Vec3 w = Vec3(0, 0, O) + (w3 - O * std::cos(theta)) * axis;
      JointScene scene;
      scene.bodies.add({.position = r * axis,
                        .rotation = rotation_by({0, theta, 0}),
                        .velocity = w.cross(r * axis),
                        .angular_velocity = w,
                        .mass = m,
                        .inertia = {Ic, Ic, I3}});
      scene.add(make_ball(scene.bodies, 0, -1, Vec3::Zero()));
      const double energy = scene.energy();
      double turned = 0, before = 0, nutation = 0;
      for (int k = 0; k < 600; ++k) {
        scene.step(1. / 60);
        const Vec3 x = scene.bodies.position(0) / r;
        const double now = std::atan2(x.y(), x.x());
        turned += std::remainder(now - before, 2 * kPi), before = now;
        nutation = std::max(nutation, std::abs(std::acos(x.z()) - theta));
      }
      EXPECT_NEAR(turned / 10 / O, 1, 1e-4) << w3 << " " << theta;
      EXPECT_LT(nutation, 1e-3);
      EXPECT_NEAR(scene.energy() / energy, 1, 1e-5);
      EXPECT_LT(scene.length_error, 1e-9);
    }
  }
}

// It is chaotic, and links whip at 50 rad/s: the energy wanders by the square of that and of the
// sub-step, by 1 J in most runs and 15 J in some. So of five, a micrometre apart, the third counts.
TEST(Joints, KeepAChainOfTenLinksForAMinute) {
  std::vector<double> errors;
  for (int run = 0; run < 5; ++run) {
    JointScene scene;
    const double z = 1e-6 * run;
    for (int k = 0; k < 10; ++k) {
      scene.add_box({0.1, 0.02, 0.02}, {0.1 + 0.2 * k, 0, z}, 0.5);
      scene.add(make_ball(scene.bodies, k, k - 1, {0.2 * k, 0, z}));
    }
    const double energy = scene.energy();
    scene.advance(60);
    EXPECT_LT(scene.length_error, 1e-6);
    errors.push_back(std::abs(scene.energy() - energy));
  }
  std::sort(errors.begin(), errors.end());
  EXPECT_LT(errors[2], 0.05 * 2 * 5 * g);
}

TEST(Joints, HoldAHeavyWeightAtALongRope) {
  JointScene scene;
  const int n = 50;
  double weight = 0;
  for (int k = 0; k < n; ++k) {
    const double mass = k == n - 1 ? 100 : 1;
    weight += mass * g;
    scene.add_box(Vec3::Constant(0.05), {0, 0, -0.05 - 0.1 * k}, mass);
    scene.add(make_ball(scene.bodies, k, k - 1, {0, 0, -0.1 * k}));
  }
  scene.bodies.set_velocity(n - 1, {1, 0, 0}, Vec3::Zero());
  scene.advance(10);
  EXPECT_LT(scene.length_error, 1e-8);

  // At rest each joint carries what hangs on it.
  JointScene still;
  for (int k = 0; k < n; ++k) {
    still.add_box(Vec3::Constant(0.05), {0, 0, -0.05 - 0.1 * k}, k == n - 1 ? 100 : 1);
    still.add(make_ball(still.bodies, k, k - 1, {0, 0, -0.1 * k}));
  }
  still.advance(0.1);
  for (int k = 0; k < n; ++k) {
    EXPECT_LT((still.joints[usize(k)].force - Vec3(0, 0, weight)).norm(), 1e-9 * weight);
    weight -= g;
  }
}

// Planks between two banks, hanging in a polygon, with a load: a loop through the world.
TEST(Joints, HoldABridge) {
  JointScene scene;
  const int n = 20;
  const auto end = [](int k) {  // on a parabola
    const double x = k / 10. - 1;
    return Vec3(5 * x, 0, x * x);
  };
  for (int k = 0; k < n; ++k) {
    const Vec3 along = end(k + 1) - end(k);
    scene.add_box({along.norm() / 2, 0.5, 0.05}, (end(k) + end(k + 1)) / 2, k == 3 ? 200 : 2,
                  Quaternion::FromTwoVectors(Vec3::UnitX(), along));
    scene.add(make_hinge(scene.bodies, k, k - 1, end(k), Vec3::UnitY()));
  }
  scene.add(make_hinge(scene.bodies, n - 1, -1, end(n), Vec3::UnitY()));
  const double energy = scene.energy();
  scene.advance(3);
  EXPECT_LT(scene.length_error, 1e-7);
  EXPECT_LT(scene.angle_error, 1e-7);
  scene.advance(7);  // it snaps taut at times
  EXPECT_LT(scene.length_error, 1e-3);
  EXPECT_LT(scene.angle_error, 1e-3);
  EXPECT_LT(scene.energy(), energy + 0.05 * 200 * g);
}

// Four bars and hinges in a plane: six equations more than motions.
TEST(Joints, TurnLoopsWithMoreEquationsThanMotions) {
  JointScene scene;
  scene.gravity.setZero();
  const Vec3 corner[4] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  for (int k = 0; k < 4; ++k) {
    const Vec3 middle = 0.5 * (corner[k] + corner[(k + 1) % 4]);
    scene.add_box(k % 2 == 0 ? Vec3(0.5, 0.05, 0.05) : Vec3(0.05, 0.5, 0.05), middle, 1 + k);
  }
  for (int k = 0; k < 4; ++k)
    scene.add(make_hinge(scene.bodies, (k + 1) % 4, k, corner[(k + 1) % 4], Vec3::UnitZ()));
  scene.bodies.set_velocity(0, {0.3, 0, 0}, Vec3::Zero());
  scene.bodies.set_velocity(2, {-0.3, 0, 0}, Vec3::Zero());
  scene.step(1. / 60);
  const double energy = scene.energy();
  scene.advance(2);
  EXPECT_LT(scene.length_error, 1e-7);
  EXPECT_LT(scene.angle_error, 1e-7);
  EXPECT_NEAR(scene.energy() / energy, 1, 1e-3);
}

TEST(Joints, FixTwoBodiesAsRigidlyAsOne) {
  // Two boxes and the one box that they make up, thrown in the same way.
  const Vec3 v(0.3, 0.2, 4), w(1, 7, 0.5);
  JointScene pair, whole;
  pair.add_box({0.1, 0.2, 0.05}, {-0.1, 0, 0}, 1);
  pair.add_box({0.1, 0.2, 0.05}, {0.1, 0, 0}, 1);
  whole.add_box({0.2, 0.2, 0.05}, Vec3::Zero(), 2);
  for (int k = 0; k < 2; ++k) pair.bodies.set_velocity(k, v + w.cross(pair.bodies.position(k)), w);
  whole.bodies.set_velocity(0, v, w);
  pair.add(make_fixed(pair.bodies, 0, 1, {0.03, 0.1, 0}));
  pair.options.rotation = whole.options.rotation = FreeRotation::kExact;
  pair.advance(2);
  whole.advance(2);
  const Vec3 middle = 0.5 * (pair.bodies.position(0) + pair.bodies.position(1));
  EXPECT_LT((middle - whole.bodies.position(0)).norm(), 1e-9);
  EXPECT_LT(pair.bodies.rotation(0).angularDistance(whole.bodies.rotation(0)), 2e-3);
  EXPECT_LT(pair.length_error, 1e-9);
  EXPECT_LT(pair.angle_error, 1e-9);
  EXPECT_LT((pair.bodies.angular_velocity(0) - pair.bodies.angular_velocity(1)).norm(), 1e-9);
}

TEST(Joints, KeepMomentaOfFreePairs) {
  std::mt19937 random(5);
  std::normal_distribution<> normal;
  const auto vector = [&] { return Vec3(normal(random), normal(random), normal(random)); };
  for (const int type : {0, 1, 2, 3, 4}) {
    JointScene scene;
    scene.gravity.setZero();
    for (int k = 0; k < 2; ++k) {
      scene.add_box({0.1, 0.2, 0.3}, Vec3(0.5 * k, 0, 0) + 0.1 * vector(), 1 + k,
                    rotation_by(vector()));
      scene.bodies.set_velocity(k, vector(), 3 * vector());
    }
    const Vec3 at(0.3, 0.1, 0), axis(1, 2, -1);
    const Bodies& b = scene.bodies;
    scene.add(type == 0   ? make_ball(b, 0, 1, at)
              : type == 1 ? make_hinge(b, 0, 1, at, axis)
              : type == 2 ? make_slider(b, 0, 1, at, axis)
              : type == 3 ? make_fixed(b, 0, 1, at)
                          : make_distance(b, 0, 1, {0, 0.1, 0.2}, {0.5, 0.1, 0}));
    scene.step(1. / 60);  // the joint's velocities become possible by an impact
    const double energy = scene.energy();
    const Vec3 momentum = b.momentum(), angular = b.angular_momentum();
    scene.advance(type == 2 ? 1 : 10);
    EXPECT_LT((b.momentum() - momentum).norm(), 1e-12) << type;  // rounding of 4800 sub-steps
    EXPECT_LT((b.angular_momentum() - angular).norm(), 1e-9) << type;
    EXPECT_NEAR(scene.energy() / energy, 1, 2e-3) << type;
    EXPECT_LT(scene.length_error, 1e-9) << type;
    EXPECT_LT(scene.angle_error, 1e-9) << type;
  }
}

TEST(Joints, FollowKinematicBodies) {
  JointScene scene;
  scene.gravity.setZero();
  scene.bodies.add({.angular_velocity = {0, 0, 5}, .motion = Motion::kKinematic});
  scene.add_box({0.3, 0.1, 0.1}, {0.5, 0, 0}, 1);
  scene.bodies.set_velocity(1, {0, 2.5, 0}, {0, 0, 5});
  scene.add(make_fixed(scene.bodies, 1, 0, {0.2, 0, 0}));
  scene.advance(4 * kPi / 5, kPi / 300);
  EXPECT_LT((scene.bodies.position(1) - Vec3(0.5, 0, 0)).norm(), 1e-9);
  // Centripetal.
  EXPECT_NEAR(scene.joints[0].force.norm(), 25 * 0.5, 0.05);
  EXPECT_LT(scene.length_error, 1e-9);
}

TEST(Joints, GiveTheSameBitsForAnyThreads) {
  const auto run = [](int threads) {
    JointScene scene;
    scene.threads = threads;
    for (int rope = 0; rope < 7; ++rope) {
      for (int k = 0; k < 4; ++k) {
        const int number = scene.add_box({0.1, 0.02, 0.03}, {0.1 + 0.2 * k, 1. * rope, 0}, 1 + k);
        scene.add(
            make_ball(scene.bodies, number, k > 0 ? number - 1 : -1, {0.2 * k, 1. * rope, 0}));
      }
    }
    scene.advance(1);
    return scene.bodies;
  };
  const Bodies one = run(1);
  for (const int threads : {2, 3}) {
    const Bodies many = run(threads);
    EXPECT_EQ(many.x, one.x);
    EXPECT_EQ(many.q, one.q);
    EXPECT_EQ(many.P, one.P);
    EXPECT_EQ(many.L, one.L);
  }
}

}  // namespace
