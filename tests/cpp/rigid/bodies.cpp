// Bodies in free motion: what is conserved, what forces at points do, what is refused.
#include "substep/rigid/motion/bodies.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "substep/core/errors.h"

namespace {

using namespace substep;
using namespace substep::rigid;

const Vec3 kGravity(0, 0, -9.81);

Bodies some(int count) {
  std::mt19937 random(3);
  std::normal_distribution<> normal;
  const auto vector = [&] { return Vec3(normal(random), normal(random), normal(random)); };
  Bodies bodies;
  for (int i = 0; i < count; ++i)
    bodies.add({.position = vector(),
                .rotation = rotation_by(vector()),
                .velocity = vector(),
                .angular_velocity = vector(),
                .mass = 0.5 + i % 3,
                .inertia = Vec3(1, 1.5, 1.2) * (1 + 0.1 * (i % 7))});
  return bodies;
}

TEST(Bodies, GiveBackWhatWasAdded) {
  Bodies bodies;
  const BodyState body{.position = {1, 2, 3},
                       .rotation = Quaternion(2, 0, 0, 2),  // is normalised
                       .velocity = {4, 5, 6},
                       .angular_velocity = {0.1, -0.2, 0.3},
                       .mass = 3,
                       .inertia = {0.3, 0.4, 0.5}};
  EXPECT_EQ(bodies.add(body), 0);
  EXPECT_EQ(bodies.add({.motion = Motion::kStatic}), 1);
  EXPECT_EQ(bodies.size(), 2);
  EXPECT_EQ(bodies.position(0), body.position);
  EXPECT_DOUBLE_EQ(bodies.rotation(0).w(), std::sqrt(0.5));
  EXPECT_LT((bodies.velocity(0) - body.velocity).norm(), 1e-15);
  EXPECT_LT((bodies.angular_velocity(0) - body.angular_velocity).norm(), 1e-15);
  // A quarter turn about z exchanges the first two moments.
  EXPECT_LT((bodies.inverse_inertia(0).inverse() - Mat3(Vec3(0.4, 0.3, 0.5).asDiagonal())).norm(),
            1e-15);
  EXPECT_EQ(bodies.inverse_mass(0), 1. / 3);
  EXPECT_EQ(bodies.inverse_mass(1), 0);
  EXPECT_EQ(bodies.inverse_inertia(1), Mat3(Mat3::Zero()));
}

TEST(Bodies, KeepMomentaAndEnergyInFreeMotion) {
  for (const auto method : {FreeRotation::kExact, FreeRotation::kSplitting}) {
    Bodies bodies = some(50);
    const double energy = bodies.kinetic_energy();
    const Vec3 momentum = bodies.momentum(), angular = bodies.angular_momentum();
    for (int k = 0; k < 2400; ++k) {
      bodies.kick(1. / 240, Vec3::Zero());
      EXPECT_EQ(bodies.drift(1. / 240, method), -1);
    }
    EXPECT_NEAR(bodies.kinetic_energy() / energy, 1, method == FreeRotation::kExact ? 1e-13 : 1e-5);
    EXPECT_EQ(bodies.momentum(), momentum);
    EXPECT_LT((bodies.angular_momentum() - angular).norm(), 1e-10);
  }
}

TEST(Bodies, FallOnParabolas) {
  // Half a kick, drift, half a kick: exact at the steps for a constant force.
  Bodies bodies = some(3);
  std::vector<Vec3> x0, v0;
  for (int i = 0; i < 3; ++i) x0.push_back(bodies.position(i)), v0.push_back(bodies.velocity(i));
  const double energy = bodies.kinetic_energy() + bodies.potential_energy(kGravity), h = 0.01;
  for (int k = 0; k < 100; ++k) {
    bodies.kick(h / 2, kGravity);
    bodies.drift(h, FreeRotation::kExact);
    bodies.kick(h / 2, kGravity);
  }
  for (int i = 0; i < 3; ++i)
    EXPECT_LT((bodies.position(i) - (x0[i] + v0[i] + kGravity / 2)).norm(), 1e-13);
  EXPECT_NEAR(bodies.kinetic_energy() + bodies.potential_energy(kGravity), energy, 1e-11);
}

TEST(Bodies, TurnByForcesAndImpulsesAtPoints) {
  Bodies bodies;
  bodies.add({.position = {1, 0, 0}, .mass = 2, .inertia = {0.4, 0.5, 0.6}});
  bodies.apply_impulse(0, {0, 3, 0}, {1.5, 0, 0});
  EXPECT_EQ(bodies.velocity(0), Vec3(0, 1.5, 0));
  EXPECT_LT((bodies.angular_velocity(0) - Vec3(0, 0, 1.5 / 0.6)).norm(), 1e-15);
  EXPECT_LT((bodies.velocity_at(0, {2, 0, 0}) - Vec3(0, 1.5 + 2.5, 0)).norm(), 1e-15);

  // A force at a point for a time is that impulse; clearing ends it.
  Bodies pushed;
  pushed.add({.position = {1, 0, 0}, .mass = 2, .inertia = {0.4, 0.5, 0.6}});
  pushed.apply_force(0, {0, 30, 0}, {1.5, 0, 0});
  pushed.kick(0.1, Vec3::Zero());
  EXPECT_LT((pushed.velocity(0) - bodies.velocity(0)).norm(), 1e-15);
  EXPECT_LT((pushed.angular_velocity(0) - bodies.angular_velocity(0)).norm(), 1e-15);
  const Vec3 momentum = pushed.momentum();
  pushed.clear_forces();
  pushed.kick(0.1, Vec3::Zero());
  EXPECT_EQ(pushed.momentum(), momentum);
}

TEST(Bodies, PrecessUnderATorqueAsAGyroscope) {
  // Steady precession of a top about its fixed point: I1 cos(theta) O^2 - I3 w3 O + m g r = 0.
  const double I1 = 0.05, I3 = 0.02, w3 = 60, weight = 9.81, r = 0.1, theta = 0.5, h = 1. / 240;
  const double a = I1 * std::cos(theta), b = I3 * w3;
  const double rate = (b - std::sqrt(b * b - 4 * a * weight * r)) / (2 * a);
  const Vec3 axis(std::sin(theta), 0, std::cos(theta));
  for (const auto method : {FreeRotation::kExact, FreeRotation::kSplitting}) {
    Bodies top;
    top.add({.rotation = rotation_by({0, theta, 0}),
             .angular_velocity = Vec3(0, 0, rate) + (w3 - rate * std::cos(theta)) * axis,
             .inertia = {I1, I1, I3}});
    const auto kick = [&] {
      const Vec3 arm = top.rotation(0) * Vec3(0, 0, r);
      top.clear_forces();
      top.apply_force(0, {0, 0, -weight}, top.position(0) + arm);
      top.P.assign(3, 0);  // the fixed point takes the force
      top.force.assign(3, 0);
      top.kick(h / 2, Vec3::Zero());
    };
    for (int k = 0; k < 240; ++k) {
      kick();
      top.drift(h, method);
      kick();
    }
    const Vec3 now = top.rotation(0) * Vec3::UnitZ();
    EXPECT_NEAR(std::atan2(now.y(), now.x()), rate, 1e-4 * rate);  // after a second
    EXPECT_NEAR(std::acos(now.z()), theta, 5e-5);                  // a nutation of O(h^2)
  }
}

TEST(Bodies, KinematicOnesFollowTheirVelocitiesAndStaticOnesStay) {
  Bodies bodies;
  const Quaternion q = rotation_by({0.3, 0.2, 0.1});
  bodies.add({.rotation = q,
              .velocity = {1, 0, 0},
              .angular_velocity = {0, 2, 0},
              .motion = Motion::kKinematic});
  bodies.add({.position = {0, 0, 7}, .rotation = q, .motion = Motion::kStatic});
  const std::vector<double> ground(bodies.q.begin() + 4, bodies.q.end());
  for (const auto method : {FreeRotation::kExact, FreeRotation::kSplitting})
    for (int k = 0; k < 50; ++k) {
      for (int i = 0; i < 2; ++i) {
        bodies.apply_force(i, {5, 5, 5}, {1, 2, 3});
        bodies.apply_impulse(i, {5, 5, 5}, {1, 2, 3});
      }
      bodies.kick(0.01, kGravity);
      bodies.drift(0.01, method);
    }
  EXPECT_LT((bodies.position(0) - Vec3(1, 0, 0)).norm(), 1e-14);
  EXPECT_LT((rotation_vector(bodies.rotation(0) * q.conjugate()) - Vec3(0, 2, 0)).norm(), 1e-13);
  EXPECT_EQ(bodies.position(1), Vec3(0, 0, 7));
  EXPECT_EQ(std::vector<double>(bodies.q.begin() + 4, bodies.q.end()), ground);
  EXPECT_EQ(bodies.kinetic_energy(), 0);
  EXPECT_EQ(bodies.momentum(), Vec3(Vec3::Zero()));
}

TEST(Bodies, AreRemovedInOrder) {
  Bodies bodies = some(6);
  const Bodies before = bodies;
  const std::int64_t gone[] = {4, 0, 4};
  EXPECT_EQ(bodies.remove(gone), (std::vector<std::int64_t>{-1, 0, 1, 2, -1, 3}));
  ASSERT_EQ(bodies.size(), 4);
  const int left[] = {1, 2, 3, 5};
  for (int i = 0; i < 4; ++i) {
    EXPECT_EQ(bodies.position(i), before.position(left[i]));
    EXPECT_EQ(bodies.rotation(i).coeffs(), before.rotation(left[i]).coeffs());
    EXPECT_EQ(bodies.velocity(i), before.velocity(left[i]));
    EXPECT_EQ(bodies.angular_velocity(i), before.angular_velocity(left[i]));
  }
  const std::int64_t wrong[] = {0, 4};
  EXPECT_THROW(bodies.remove(wrong), InputError);
  EXPECT_EQ(bodies.size(), 4);
  const std::int64_t all[] = {0, 1, 2, 3};
  bodies.remove(all);
  EXPECT_EQ(bodies.size(), 0);
  EXPECT_EQ(bodies.drift(1, FreeRotation::kExact), -1);
}

TEST(Bodies, HaveTheSameBitsForAnyNumberOfThreads) {
  Bodies one = some(3000), three = one;
  for (int k = 0; k < 5; ++k) {
    one.kick(0.01, kGravity, 1), three.kick(0.01, kGravity, 3);
    one.drift(0.01, FreeRotation::kSplitting, 1), three.drift(0.01, FreeRotation::kSplitting, 3);
  }
  EXPECT_EQ(one.x, three.x);
  EXPECT_EQ(one.q, three.q);
  EXPECT_EQ(one.P, three.P);
}

TEST(Bodies, TellWhichIsNotFinite) {
  Bodies bodies = some(3000);
  bodies.L[3 * 2500 + 1] = std::nan("");
  bodies.P[3 * 1700] = HUGE_VAL;
  EXPECT_EQ(bodies.drift(0.01, FreeRotation::kSplitting, 2), 1700);
}

TEST(Bodies, RefuseWhatIsNone) {
  Bodies bodies;
  const auto refused = [&](const BodyState& body, const std::string& name) {
    try {
      bodies.add(body);
      ADD_FAILURE() << "accepted a bad " << name;
    } catch (const InputError& error) {
      EXPECT_EQ(std::string(error.what()).find(name), 0u) << error.what();
    }
    EXPECT_EQ(bodies.size(), 0);
  };
  const double nan = std::nan("");
  refused({.position = {nan, 0, 0}}, "position");
  refused({.velocity = {0, HUGE_VAL, 0}}, "velocity");
  refused({.angular_velocity = {0, nan, 0}}, "angular_velocity");
  refused({.rotation = Quaternion(0, 0, 0, 0)}, "rotation");
  refused({.rotation = Quaternion(nan, 0, 0, 0)}, "rotation");
  for (const double mass : {0.0, -1.0, nan, HUGE_VAL}) refused({.mass = mass}, "mass");
  refused({.inertia = {1, 1, 0}}, "inertia");
  refused({.inertia = {1, -1, 1}}, "inertia");
  refused({.inertia = {1, 1, 3}}, "inertia");
  refused({.inertia = {1, 1, nan}}, "inertia");
  refused({.velocity = {1, 0, 0}, .motion = Motion::kStatic}, "velocity");
}

}  // namespace
