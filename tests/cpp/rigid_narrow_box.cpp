// Boxes: closed forms of simple poses.
#include <gtest/gtest.h>

#include "substep/rigid/narrow_phase.h"

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

}  // namespace
}  // namespace substep::rigid
