#include "substep/geometry/collider.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "substep/core/errors.h"

namespace {

using namespace substep::geometry;

TEST(Exchange, SumsImpulseAndTorqueAboutThePosition) {
  Exchange one, two;
  one.add({1, 0, 0}, {0, 2, 0});
  two.add({0, 3, 0}, {0, 0, 5});
  one += two;
  EXPECT_EQ(one.impulse, Vec3(0, 2, 5));
  EXPECT_EQ(one.torque, Vec3(15, 0, 2));
}

TEST(Collider, IsAValueThatACopyRestores) {
  Collider box(Box{{1, 2, 3}}, {0, 0, 1});
  box.velocity = {1, 0, 0};
  box.angular_velocity = {0.3, -0.2, 0.1};
  box.friction = 0.5;
  const Collider before = box;
  Exchange given;
  given.add({1, 0, 0}, {0, 1, 0});
  box.set_exchange(given);
  for (int i = 0; i < 3; ++i) box.advance(0.1);
  EXPECT_NE(box.state(), before.state());
  box = before;
  EXPECT_EQ(box.state(), before.state());
  const Vec3 x(0.4, 3, -2);
  EXPECT_EQ(box.signed_distance(x).value, before.signed_distance(x).value);
}

TEST(Collider, TurnsByTheExponentialOfItsAngularVelocity) {
  Collider plane(Plane{{0, 0, 1}}, {0, 0, 0});
  plane.angular_velocity = {std::numbers::pi / 2, 0, 0};
  for (int i = 0; i < 10; ++i) plane.advance(0.1);
  EXPECT_NEAR((plane.signed_distance({0, -1, 0}).gradient - Vec3(0, -1, 0)).norm(), 0, 1e-14);
  EXPECT_NEAR(plane.signed_distance({7, -1, 3}).value, 1, 1e-14);
}

TEST(Collider, RefusesAZeroQuaternion) {
  Collider plane(Plane{{0, 0, 1}}, {0, 0, 0});
  const auto before = plane.state();
  EXPECT_THROW(plane.set_orientation(Quaternion(0, 0, 0, 0)), substep::InputError);
  EXPECT_EQ(plane.state(), before);
}

TEST(SampledDistance, ReproducesALinearFieldExactly) {
  std::vector<double> values;
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < 7; ++j)
      for (int k = 0; k < 8; ++k) values.push_back(1 + 0.125 * i + 0.25 * j + 0.0625 * k);
  const SampledDistance field({6, 7, 8}, {1, 2, 3}, 0.5, values);
  const auto [value, gradient] = field.signed_distance({2.1, 3.3, 4.7});
  EXPECT_NEAR(value, 1 + 0.25 * 1.1 + 0.5 * 1.3 + 0.125 * 1.7, 1e-14);
  EXPECT_NEAR((gradient - Vec3(0.25, 0.5, 0.125)).norm(), 0, 1e-14);
  EXPECT_NEAR(field.hessian({2.1, 3.3, 4.7}).norm(), 0, 1e-13);
  EXPECT_EQ(field.lipschitz(false), 1);
  EXPECT_TRUE(std::isnan(field.signed_distance({0, std::nan(""), 0}).value));
}

}  // namespace
