// Spheres, capsules and cylinders: closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "shapes.h"

namespace substep::rigid {
namespace {

Pose upright(double x, double y, double z) { return Pose(Vec3(x, y, z), Mat3::Identity()); }
Pose turned(const Vec3& x, double angle, const Vec3& axis) {
  return Pose(x, Quaternion(Eigen::AngleAxisd(angle, axis)));
}
Manifold contact(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                 double margin = 0.01) {
  Manifold manifold;
  Cache cache;
  collide(a, pose_a, b, pose_b, margin, manifold, cache);
  return manifold;
}
void expect_points(const Manifold& manifold, const Vec3& normal, const std::vector<Vec3>& on_b,
                   double separation) {
  ASSERT_EQ(manifold.count, static_cast<int>(on_b.size()));
  EXPECT_LT((manifold.normal - normal).norm(), 1e-9);
  for (const Vec3& want : on_b) {
    double nearest = 1;
    for (int k = 0; k < manifold.count; ++k) {
      nearest = std::min(nearest, (manifold.points[k].on_b - want).norm());
    }
    EXPECT_LT(nearest, 1e-9) << want.transpose();
  }
  for (int k = 0; k < manifold.count; ++k) {
    EXPECT_NEAR(manifold.points[k].separation, separation, 1e-10);
  }
}

TEST(NarrowRound, SphereOnWhatHasAClosedForm) {
  const Shape ball = Sphere{0.5};
  expect_points(contact(ball, upright(0, 0, 0), Sphere{0.25}, upright(0.6, 0, 0.0)), {1, 0, 0},
                {{0.35, 0, 0}}, -0.15);
  expect_points(contact(ball, upright(1, 2, 0.505), Plane{{0, 0, 1}, 0}, Pose()), {0, 0, -1},
                {{1, 2, 0}}, 0.005);
  // The side and the end of a capsule along z.
  const Shape capsule = Capsule{0.2, 1};
  expect_points(contact(ball, upright(0.6, 0, 0.3), capsule, Pose()), {-1, 0, 0}, {{0.2, 0, 0.3}},
                -0.1);
  expect_points(contact(ball, upright(0.36, 0, 1.48), capsule, Pose()), {-0.6, 0, -0.8},
                {{0.12, 0, 1.16}}, -0.1);
  // A face, an edge and a corner of a box, and from inside.
  const Shape box = Box{{1, 2, 3}};
  expect_points(contact(ball, upright(1.4, 0, 0), box, Pose()), {-1, 0, 0}, {{1, 0, 0}}, -0.1);
  expect_points(contact(ball, upright(1.3, 2.4, 0), box, Pose()), {-0.6, -0.8, 0}, {{1, 2, 0}}, 0);
  expect_points(contact(ball, upright(1 + 2.0 / 6, 2 + 1.0 / 6, 3 + 2.0 / 6), box, Pose()),
                Vec3(-2, -1, -2) / 3, {{1, 2, 3}}, 0);
  expect_points(contact(ball, upright(0.9, 0, 0), box, Pose()), {-1, 0, 0}, {{1, 0, 0}}, -0.6);
  // Side, cap and rim of a cylinder.
  const Shape cylinder = Cylinder{1, 2};
  expect_points(contact(ball, upright(0, 1.4, 0.5), cylinder, Pose()), {0, -1, 0}, {{0, 1, 0.5}},
                -0.1);
  expect_points(contact(ball, upright(0.5, 0, 2.4), cylinder, Pose()), {0, 0, -1}, {{0.5, 0, 2}},
                -0.1);
  expect_points(contact(ball, upright(1.3, 0, 2.4), cylinder, Pose()), {-0.6, 0, -0.8}, {{1, 0, 2}},
                0);
  EXPECT_EQ(contact(ball, upright(0, 0, 5), cylinder, Pose()).count, 0);
  // The same centre: any direction, full depth.
  const Manifold same = contact(ball, upright(1, 1, 1), ball, upright(1, 1, 1));
  ASSERT_EQ(same.count, 1);
  EXPECT_EQ(same.points[0].separation, -1);
}

TEST(NarrowRound, CapsulesCrossingAlongAndOnEnd) {
  const Shape capsule = Capsule{0.1, 0.5};
  const Pose lying = turned({0, 0, 0.195}, kQuarter, Vec3::UnitX());  // along y
  const Pose across = turned({0, 0, 0}, kQuarter, Vec3::UnitY());     // along x
  expect_points(contact(capsule, across, capsule, lying), {0, 0, 1}, {{0, 0, 0.095}}, -0.005);
  // Side by side: the ends of what they share.
  const Pose beside = turned({0.2, 0, 0.195}, kQuarter, Vec3::UnitY());
  expect_points(contact(capsule, across, capsule, beside), {0, 0, 1},
                {{-0.3, 0, 0.095}, {0.5, 0, 0.095}}, -0.005);
  // Axes that cross: out along their common normal.
  const Manifold crossing =
      contact(capsule, across, capsule, turned({0, 0, 0}, kQuarter, Vec3::UnitX()));
  ASSERT_EQ(crossing.count, 1);
  EXPECT_NEAR(std::abs(crossing.normal.z()), 1, 1e-12);
  EXPECT_NEAR(crossing.points[0].separation, -0.2, 1e-12);
  // On top of itself: some direction across the axis.
  const Manifold same = contact(capsule, across, capsule, across);
  ASSERT_GE(same.count, 1);
  EXPECT_NEAR(same.normal.x(), 0, 1e-9);
  EXPECT_NEAR(deepest(same), -0.2, 1e-9);
}

TEST(NarrowRound, CapsuleOnABox) {
  const Shape capsule = Capsule{0.1, 0.5}, box = Box{{1, 1, 0.2}};
  const auto along_x = [](double x, double y, double z) {
    return turned({x, y, z}, kQuarter, Vec3::UnitY());
  };
  expect_points(contact(capsule, along_x(0, 0, 0.295), box, Pose()), {0, 0, -1},
                {{-0.5, 0, 0.2}, {0.5, 0, 0.2}}, -0.005);
  // Half of it beyond the edge: it ends there.
  expect_points(contact(capsule, along_x(0.9, 0.3, 0.305), box, Pose()), {0, 0, -1},
                {{0.4, 0.3, 0.2}, {1, 0.3, 0.2}}, 0.005);
  // Standing; across an edge; its axis in the box.
  expect_points(contact(capsule, upright(0.3, 0.2, 0.79), box, Pose()), {0, 0, -1},
                {{0.3, 0.2, 0.2}}, -0.01);
  const Pose tilted = turned({1.07, 0, 0.27}, -kQuarter / 2, Vec3::UnitY());  // along (-1, 0, 1)
  expect_points(contact(capsule, tilted, box, Pose()), Vec3(-1, 0, -1).normalized(), {{1, 0, 0.2}},
                0.07 * std::numbers::sqrt2 - 0.1);
  const Manifold inside = contact(capsule, along_x(0, 0, 0.15), box, Pose());
  EXPECT_NEAR(inside.normal.z(), -1, 1e-12);
  EXPECT_NEAR(deepest(inside), -0.15, 1e-9);
}

TEST(NarrowRound, CylinderStandsLiesAndLeans) {
  const Shape cylinder = Cylinder{0.5, 0.4}, floor = Plane{{0, 0, 1}, 0}, slab = Box{{3, 3, 1}};
  const Pose below = upright(0, 0, -1);
  for (const Shape& ground : {floor, slab}) {
    const Pose pose = std::holds_alternative<Plane>(ground) ? Pose() : below;
    const Manifold standing = contact(cylinder, upright(0, 0, 0.395), ground, pose);
    ASSERT_EQ(standing.count, 4);
    EXPECT_NEAR(deepest(standing), -0.005, 1e-12);
    Vec3 sum = Vec3::Zero();  // evenly around the axis
    for (const ContactPoint& p : standing.points) sum += p.on_b;
    EXPECT_LT(sum.head<2>().norm(), 0.25);
    const Pose on_side = turned({0, 0, 0.495}, kQuarter, Vec3::UnitX());
    expect_points(contact(cylinder, on_side, ground, pose), {0, 0, -1}, {{0, -0.4, 0}, {0, 0.4, 0}},
                  -0.005);
    const double tilt = 0.3;  // about y: the rim at -x is lowest
    const double height = 0.4 * std::cos(tilt) + 0.5 * std::sin(tilt);
    const Manifold leaning =
        contact(cylinder, turned({0, 0, height - 0.002}, -tilt, Vec3::UnitY()), ground, pose);
    EXPECT_NEAR(deepest(leaning), -0.002, 1e-9);
    EXPECT_LT((leaning.normal - Vec3(0, 0, -1)).norm(), 1e-9);
  }
  // Coins in a stack, and rolls side by side.
  const Manifold stack = contact(cylinder, Pose(), cylinder, upright(0.1, 0.05, 0.795));
  EXPECT_EQ(stack.count, 4);
  EXPECT_NEAR(deepest(stack), -0.005, 1e-12);
  const Manifold rolls = contact(cylinder, Pose(), cylinder, upright(0.995, 0, 0.2));
  EXPECT_LT((rolls.normal - Vec3::UnitX()).norm(), 1e-12);
  ASSERT_EQ(rolls.count, 2);
  for (int k = 0; k < 2; ++k) {
    const Vec3& p = rolls.points[k].on_b;
    EXPECT_LT((p - Vec3(0.495, 0, p.z() < 0 ? -0.2 : 0.4)).norm(), 1e-12);
    EXPECT_NEAR(rolls.points[k].separation, -0.005, 1e-9);
  }
  // Rims that cross, at a right angle.
  const Manifold cross =
      contact(cylinder, Pose(), cylinder, turned({0.99, 0, 0}, kQuarter, Vec3::UnitX()));
  ASSERT_EQ(cross.count, 1);
  EXPECT_NEAR(cross.points[0].separation, -0.01, 1e-9);
  EXPECT_LT((cross.normal - Vec3::UnitX()).norm(), 1e-12);
}

// Each box of a hundred in one place has a way out, of the right depth.
TEST(NarrowRound, AHundredCoincidentBoxes) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  for (int k = 0; k < 100; ++k) {
    const Manifold manifold = contact(box, upright(3, 2, 1), box, upright(3, 2, 1));
    ASSERT_EQ(manifold.count, 4);
    EXPECT_NEAR(deepest(manifold), -1, 1e-15);
    EXPECT_EQ(manifold.normal.cwiseAbs().sum(), 1);
  }
}

// Nothing touches what is nowhere, and nothing hangs.
TEST(NarrowRound, NotANumberTouchesNothing) {
  Random random(8);
  const double nan = std::nan("");
  for (const auto& [name_a, a] : shapes(random)) {
    for (const auto& [name_b, b] : shapes(random)) {
      SCOPED_TRACE(testing::Message() << name_a << ' ' << name_b);
      EXPECT_EQ(contact(a, Pose(), b, upright(nan, nan, nan)).count, 0);
      EXPECT_EQ(contact(a, upright(1e300, 0, 0), b, Pose()).count, 0);
    }
  }
}

}  // namespace
}  // namespace substep::rigid
