// Boxes: closed forms of simple poses.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "shapes.h"

namespace substep::rigid {
namespace {

TEST(NarrowBox, RestsOnAPlaneWithFourCorners) {
  const Shape box = Box{{0.5, 0.4, 0.3}}, plane = Plane{{0, 0, 1}, 0};
  Manifold manifold;
  Cache cache;
  ASSERT_TRUE(collide(box, Pose({1, 2, 0.29}, Quaternion::Identity()), plane, Pose(), 0.02,
                      manifold, cache));
  ASSERT_EQ(manifold.count, 4);
  EXPECT_EQ(manifold.normal, Vec3(0, 0, -1));
  for (int k = 0; k < 4; ++k) EXPECT_NEAR(manifold.points[k].separation, -0.01, 1e-15);
  ASSERT_TRUE(collide(plane, Pose(), box, Pose({1, 2, 0.31}, Quaternion::Identity()), 0.02,
                      manifold, cache));
  EXPECT_EQ(manifold.normal, Vec3(0, 0, 1));
  EXPECT_NEAR(manifold.points[0].separation, 0.01, 1e-15);
  EXPECT_FALSE(collide(plane, Pose(), box, Pose({1, 2, 0.33}, Quaternion::Identity()), 0.02,
                       manifold, cache));
}

TEST(NarrowBox, StackedBoxesShareTheOverlapOfTheirFaces) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  Manifold manifold;
  Cache cache;
  ASSERT_TRUE(collide(box, Pose(), box, Pose({0.2, 0.3, 0.99}, Quaternion::Identity()), 0.01,
                      manifold, cache));
  ASSERT_EQ(manifold.count, 4);
  EXPECT_EQ(manifold.normal, Vec3(0, 0, 1));
  Vec3 low = Vec3::Constant(1e9), high = -low;
  for (int k = 0; k < 4; ++k) {
    EXPECT_NEAR(manifold.points[k].separation, -0.01, 1e-15);
    low = low.cwiseMin(manifold.points[k].on_a);
    high = high.cwiseMax(manifold.points[k].on_a);
  }
  EXPECT_LT((low - Vec3(-0.3, -0.2, 0.5)).norm(), 1e-14);
  EXPECT_LT((high - Vec3(0.5, 0.5, 0.5)).norm(), 1e-14);
}

// Two edges at right angles, both at 45 degrees to the vertical, d apart.
TEST(NarrowBox, EdgesThatCross) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  const double quarter = std::numbers::pi / 4, reach = std::sqrt(0.5);
  const Quaternion edge_along_x(Eigen::AngleAxisd(quarter, Vec3::UnitX()));
  const Quaternion edge_along_y(Eigen::AngleAxisd(quarter, Vec3::UnitY()));
  for (const double d : {-0.02, -1e-6, 0.0, 1e-6, 0.02}) {
    Manifold manifold;
    Cache cache;
    ASSERT_TRUE(collide(box, Pose(Vec3::Zero(), edge_along_x), box,
                        Pose({0.1, -0.2, 2 * reach + d}, edge_along_y), 0.03, manifold, cache));
    ASSERT_EQ(manifold.count, 1);
    EXPECT_LT((manifold.normal - Vec3::UnitZ()).norm(), 1e-12);
    EXPECT_NEAR(manifold.points[0].separation, d, 1e-12);
    EXPECT_LT((manifold.points[0].on_a - Vec3(0.1, 0, reach)).norm(), 1e-12);
  }
}

// On an edge over a face: two points, and over its end: one of them goes.
TEST(NarrowBox, TiltedBoxTouchesWithAnEdge) {
  const Shape box = Box{{0.5, 0.5, 0.5}}, slab = Box{{2, 2, 0.5}};
  const Quaternion tilt(Eigen::AngleAxisd(0.3, Vec3::UnitY()));
  const double low = 0.5 * (std::cos(0.3) + std::sin(0.3));
  Manifold manifold;
  Cache cache;
  ASSERT_TRUE(
      collide(slab, Pose(), box, Pose({0, 0, 0.5 + low - 1e-3}, tilt), 0.02, manifold, cache));
  ASSERT_EQ(manifold.count, 2);
  for (int k = 0; k < 2; ++k) {
    EXPECT_NEAR(manifold.points[k].separation, -1e-3, 1e-12);
    EXPECT_NEAR(std::abs(manifold.points[k].on_b.y()), 0.5, 1e-12);
    EXPECT_NEAR(manifold.points[k].on_a.z(), 0.5, 1e-12);
  }
}

// Apart, corner to corner: the distance, not that of planes.
TEST(NarrowBox, CornerToCorner) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  Manifold manifold;
  Cache cache;
  const Vec3 d(0.01, 0.02, 0.02);
  ASSERT_TRUE(collide(box, Pose(), box, Pose(Vec3::Ones() + d, Quaternion::Identity()), 0.05,
                      manifold, cache));
  ASSERT_EQ(manifold.count, 1);
  EXPECT_NEAR(manifold.points[0].separation, 0.03, 1e-12);
  EXPECT_LT((manifold.normal - d / 0.03).norm(), 1e-12);
  EXPECT_FALSE(collide(box, Pose(), box, Pose(Vec3::Ones() + d, Quaternion::Identity()), 0.029,
                       manifold, cache));
}

// Four points of the eight of an octagon: the deepest is among them and they span most of it.
TEST(NarrowBox, ReductionKeepsDepthAndArea) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  for (int k = 1; k < 90; ++k) {
    const double yaw = k * std::numbers::pi / 180;
    for (const double tilt : {0.0, 1e-3, 0.02}) {
      const Quaternion q = Quaternion(Eigen::AngleAxisd(yaw, Vec3::UnitZ())) *
                           Quaternion(Eigen::AngleAxisd(tilt, Vec3(0.6, 0.8, 0)));
      Manifold manifold;
      Cache cache;
      const double low = 0.5 * (q.toRotationMatrix().row(2).cwiseAbs().sum());
      ASSERT_TRUE(collide(Box{{3, 3, 0.5}}, Pose(), box, Pose({0, 0, 0.5 + low - 0.01}, q), 0.05,
                          manifold, cache));
      EXPECT_NEAR(deepest(manifold), -0.01, 1e-12);
      ASSERT_TRUE(collide(box, Pose(), box,
                          Pose({0, 0, 0.99}, Quaternion(Eigen::AngleAxisd(yaw, Vec3::UnitZ()))),
                          0.01, manifold, cache));
      ASSERT_EQ(manifold.count, 4);
      double area = 0;
      for (int j = 0; j < 4; ++j) {
        const Vec3 &p = manifold.points[j].on_a, &r = manifold.points[(j + 1) % 4].on_a;
        area += 0.5 * (p.x() * r.y() - r.x() * p.y());
      }
      EXPECT_GT(std::abs(area), 0.52);  // no four of a regular octagon span more than 0.586
    }
  }
}

// An edge over the edge of a face, tilted by `slope` down and beyond it: the axis across both edges
// separates by 0, that of the face by the depth of the end outside. Up to 1/50 of the half length
// the face is taken, and the edge lies on it with two points.
TEST(NarrowBox, FacesArePreferredWhereEdgesAreLittleBetter) {
  const Shape box = Box{{0.5, 0.5, 0.5}};
  for (const double slope : {0.003, 0.01, 0.019, 0.021, 0.05}) {
    const Vec3 d(std::cos(slope), 0, -std::sin(slope)), n(std::sin(slope), 0, std::cos(slope));
    const Vec3 e = std::sqrt(0.5) * (n + Vec3::UnitY());
    Mat3 R;
    R << d, e, d.cross(e);
    Manifold manifold;
    Cache cache;
    const Pose pose(Vec3(0.5, 0, 0.5) + std::sqrt(0.5) * n, R);
    ASSERT_TRUE(collide(box, Pose(), box, pose, 0.02, manifold, cache));
    const bool face = 0.5 * std::sin(slope) < 0.5 / 50;
    EXPECT_EQ(manifold.count, face ? 2 : 1);
    EXPECT_LT((manifold.normal - (face ? Vec3::UnitZ() : n)).norm(), 1e-12);
    EXPECT_NEAR(deepest(manifold), 0, 1e-12);
  }
}

// While a box slides over another its corners keep their names; those cut change at most at events.
TEST(NarrowBox, FeaturesPersistWhileSliding) {
  const Shape box = Box{{0.5, 0.5, 0.5}}, slab = Box{{5, 5, 0.5}};
  std::vector<std::uint32_t> names;
  for (int k = 0; k < 1000; ++k) {
    const Quaternion turn(Eigen::AngleAxisd(1e-3 * k, Vec3::UnitZ()));
    Manifold manifold;
    Cache cache;
    ASSERT_TRUE(
        collide(slab, Pose(), box, Pose({2e-3 * k, 1e-3 * k, 0.999}, turn), 0.01, manifold, cache));
    ASSERT_EQ(manifold.count, 4);
    std::vector<std::uint32_t> now;
    for (const ContactPoint& p : manifold.points) now.push_back(p.feature);
    std::sort(now.begin(), now.end());
    if (k == 0) names = now;
    ASSERT_EQ(now, names) << k;
  }
}

}  // namespace
}  // namespace substep::rigid
