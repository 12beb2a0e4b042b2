#include "substep/geometry/collider.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "substep/core/errors.h"
#include "substep/geometry/bounding_balls.h"

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

// Central differences of the distance and of its gradient, away from edges, ends and axes.
template <class Shape>
void expect_derivatives(const Shape& shape, const std::vector<Vec3>& points) {
  constexpr double kStep = 1e-5;
  for (const Vec3& x : points) {
    const SignedDistance at = shape.signed_distance(x);
    const Mat3 hessian = shape.hessian(x);
    EXPECT_NEAR(at.gradient.norm(), 1, 1e-14);
    for (int axis = 0; axis < 3; ++axis) {
      const Vec3 step = kStep * Vec3::Unit(axis);
      const SignedDistance more = shape.signed_distance(x + step);
      const SignedDistance less = shape.signed_distance(x - step);
      EXPECT_NEAR((more.value - less.value) / (2 * kStep), at.gradient[axis], 1e-9);
      const Vec3 slope = (more.gradient - less.gradient) / (2 * kStep);
      EXPECT_NEAR((slope - hessian.col(axis)).norm(), 0, 1e-8) << x.transpose();
    }
  }
}

TEST(Capsule, HasTheDistanceOfItsSegmentAndItsDerivatives) {
  const Capsule capsule{0.5, 1};
  EXPECT_EQ(capsule.signed_distance({2, 0, 0.7}).value, 1.5);
  EXPECT_EQ(capsule.signed_distance({0, 3, 5}).value, 4.5);
  EXPECT_EQ(capsule.signed_distance({0, 0, -1.25}).value, -0.25);
  EXPECT_EQ(capsule.signed_distance({0, 0, 0.3}).gradient, Vec3(1, 0, 0));
  expect_derivatives(
      capsule, {{0.3, 0.1, 0.2}, {0.7, -0.9, -0.5}, {0.2, 0.4, 1.3}, {-0.1, 0.2, -1.1}, {1, 2, 3}});
}

TEST(Cylinder, HasTheDistanceOfItsSideItsEndsAndItsEdges) {
  const Cylinder cylinder{0.5, 1};
  EXPECT_EQ(cylinder.signed_distance({2, 0, 0.7}).value, 1.5);
  EXPECT_EQ(cylinder.signed_distance({0, 0.25, -3}).value, 2);
  EXPECT_EQ(cylinder.signed_distance({3.5, 0, 5}).value, 5);
  EXPECT_EQ(cylinder.signed_distance({0, 0.25, 0.2}).value, -0.25);
  EXPECT_EQ(cylinder.signed_distance({0, 0.25, 0.9}).gradient, Vec3(0, 0, 1));
  EXPECT_EQ(cylinder.signed_distance({0, 0, 0}).gradient, Vec3(1, 0, 0));
  expect_derivatives(cylinder, {{0.3, 0.1, 0.2},
                                {0.2, 0.1, 0.9},
                                {0.7, -0.9, -0.5},
                                {0.2, 0.4, 1.3},
                                {-0.1, 0.2, -1.1},
                                {1, 2, 3},
                                {-1, 0.5, -2}});
}

TEST(Triangle, HasTheDistanceOfItsFacesItsEdgesAndItsCorners) {
  const Triangle triangle{{0, 0, 0}, {2, 0, 0}, {0, 2, 0}, 0.1};
  EXPECT_EQ(triangle.signed_distance({0.5, 0.5, 1}).value, 0.9);
  EXPECT_EQ(triangle.signed_distance({0.5, 0.5, -1}).gradient, Vec3(0, 0, -1));
  EXPECT_EQ(triangle.signed_distance({1, -3, 4}).value, 4.9);
  EXPECT_EQ(triangle.signed_distance({-2, -1, 2}).value, 2.9);
  EXPECT_NEAR(triangle.signed_distance({0.5, 0.5, 0.05}).value, -0.05, 1e-16);  // two sides
  EXPECT_EQ(triangle.signed_distance({0.5, 0.5, -0.05}).gradient, Vec3(0, 0, -1));
  EXPECT_EQ(triangle.signed_distance({0.5, 0.5, 0}).gradient, Vec3(0, 0, 1));
  expect_derivatives(triangle, {{0.5, 0.4, 0.05},
                                {0.5, 0.4, -1},
                                {1, -0.5, 0.3},
                                {-0.5, 1, -0.3},
                                {1.5, 1.7, 0.2},
                                {-1, -2, 0.5},
                                {3, -0.1, 1},
                                {0.2, 3, -1}});
}

TEST(Collider, SaysThatItsShapeIsAnother) {
  Collider facet(Triangle{{0, 0, 0}, {2, 0, 0}, {0, 2, 0}, 0.1}, {0, 0, 1});
  const Collider before = facet;
  facet.set_shape(Triangle{{0, 0, 0}, {3, 0, 0}, {0, 2, 0}, 0.1});
  EXPECT_EQ(facet.shapes(), before.shapes() + 1);
  EXPECT_NEAR(facet.signed_distance({2.5, 0, 2}).value, 0.9, 1e-15);
  EXPECT_GT(before.signed_distance({2.5, 0, 2}).value, 1);
}

// Of many obstacles and points: nobody who is as near is left out, and few others are found.
TEST(BoundingBalls, FindAllThatAreNear) {
  std::vector<Collider> all;
  const auto wave = [](int k, double a) { return 2 * std::sin(a * k + a); };
  for (int k = 0; k < 60; ++k) {
    const Vec3 at(wave(k, 1.1), wave(k, 2.3), wave(k, 3.7));
    const Shape shapes[] = {Sphere{0.3},
                            Box{{0.2, 0.1, 0.3}},
                            Capsule{0.1, 0.2},
                            Cylinder{0.2, 0.1},
                            Triangle{{-0.3, 0, 0}, {0.4, 0.1, 0}, {0, 0.2, 0.3}, 0.05},
                            Plane{Vec3::UnitZ()}};
    all.emplace_back(shapes[k % 6], at, k % 6 == 1 && k % 4 == 0);
    all.back().set_orientation(Quaternion(1, wave(k, 0.7), wave(k, 1.9), wave(k, 0.3)));
  }
  BoundingBalls balls;
  for (const Collider& collider : all) balls.add(collider);
  EXPECT_EQ(balls.size(), 60);
  std::vector<std::int32_t> found;
  int near = 0, listed = 0;
  for (int p = 0; p < 500; ++p) {
    const Vec3 x(wave(p, 0.9), wave(p, 1.7), wave(p, 2.9));
    for (const double reach : {-0.05, 0.0, 0.2}) {
      balls.find(x, reach, found);
      EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
      listed += static_cast<int>(found.size());
      for (std::int32_t c = 0; c < 60; ++c) {
        const bool is_near = all[static_cast<std::size_t>(c)].signed_distance(x).value <= reach;
        const bool is_found = std::binary_search(found.begin(), found.end(), c);
        EXPECT_TRUE(is_found || !is_near) << c << ' ' << p;
        const PlacedBall ball(all[static_cast<std::size_t>(c)]);
        EXPECT_EQ(!ball.beyond(x, reach), is_found);
        near += is_near ? 1 : 0;
      }
    }
  }
  EXPECT_GT(near, 1000);
  EXPECT_LT(listed, 60 * 3 * 500 / 3);
}

TEST(Sampled, IsTheDistanceWithinItsBound) {
  for (const Shape& shape : {Shape(Capsule{0.5, 1}), Shape(Cylinder{0.5, 0.1})}) {
    const auto field = sampled(shape, 1);
    for (const Vec3& x : {Vec3(0.1, 0.2, 0.05), Vec3(0.45, 0, 0), Vec3(0.4, 0.4, 0.09)}) {
      const double exact = Collider(shape, Vec3::Zero()).signed_distance(x).value;
      EXPECT_NEAR(field->signed_distance(x).value, exact, field->error_bound());
    }
  }
}

TEST(Collider, SumsWhatItWasGivenOverACall) {
  Collider floor(Plane{{0, 0, 1}}, {0, 0, 0});
  Exchange given;
  given.add({1, 0, 0}, {0, 0, -2});
  const auto step = [&] {
    floor.set_exchange(given);
    floor.end_step(0.25);
  };
  step();
  floor.begin_call();
  EXPECT_EQ(floor.duration(), 0.25);  // a call that takes no step changes nothing
  step();
  step();
  EXPECT_EQ(floor.total().impulse, Vec3(0, 0, -4));
  EXPECT_EQ(floor.total().torque, Vec3(0, 4, 0));
  EXPECT_EQ(floor.duration(), 0.5);
  floor.restore(floor.state());
  EXPECT_EQ(floor.duration(), 0);
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
