// Convex hulls of points.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "shapes.h"
#include "substep/core/errors.h"

namespace substep::rigid {
namespace {

// V - E + F = 2, faces flat and turned outward, all points inside.
void check_hull(const ConvexHull& hull, const std::vector<Vec3>& points, double tolerance) {
  int corners = 0;
  for (int f = 0; f < hull.face_count(); ++f) {
    const auto loop = hull.corners(f);
    const FacePlane& plane = hull.plane(f);
    ASSERT_GE(loop.size(), 3u);
    EXPECT_NEAR(plane.normal.norm(), 1, 1e-12);
    corners += static_cast<int>(loop.size());
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const Vec3& a = hull.vertices()[loop[k]];
      const Vec3& b = hull.vertices()[loop[(k + 1) % loop.size()]];
      const Vec3& c = hull.vertices()[loop[(k + 2) % loop.size()]];
      EXPECT_NEAR(plane.normal.dot(a), plane.offset, tolerance);
      EXPECT_GT((b - a).cross(c - b).dot(plane.normal), 0);
    }
    for (const Vec3& p : points) ASSERT_LE(plane.normal.dot(p) - plane.offset, tolerance);
  }
  EXPECT_EQ(hull.vertex_count() - corners / 2 + hull.face_count(), 2);
}

std::vector<Vec3> lattice(int n) {
  std::vector<Vec3> points;
  for (int k = 0; k < n * n * n; ++k) {
    points.emplace_back(k % n, k / n % n, k / (n * n));
  }
  return points;
}

std::vector<Vec3> prism(int n) {
  std::vector<Vec3> points;
  for (int k = 0; k < n; ++k) {
    const double angle = 2 * std::numbers::pi * k / n;
    for (const double z : {-0.5, 0.5}) points.emplace_back(std::cos(angle), std::sin(angle), z);
  }
  return points;
}

TEST(NarrowHull, FacesInOnePlaneAreOne) {
  for (const int n : {2, 3, 6}) {
    const std::vector<Vec3> points = lattice(n);
    const ConvexHull cube(points);
    EXPECT_EQ(cube.vertex_count(), 8);
    EXPECT_EQ(cube.face_count(), 6);
    check_hull(cube, points, 1e-12);
  }
  for (const int n : {3, 5, 8, 100}) {
    const std::vector<Vec3> points = prism(n);
    const ConvexHull hull(points);
    EXPECT_EQ(hull.vertex_count(), 2 * n);
    EXPECT_EQ(hull.face_count(), n + 2);
    check_hull(hull, points, 1e-12);
  }
}

TEST(NarrowHull, OfRandomPoints) {
  Random random(3);
  for (const int n : {4, 5, 8, 20, 100, 1000}) {
    for (int repeat = 0; repeat < (n <= 100 ? 20 : 2); ++repeat) {
      std::vector<Vec3> ball, sphere;
      for (int k = 0; k < n; ++k) {
        const Vec3 d = direction(random);
        ball.push_back(uniform(random, 0, 1) * d);
        sphere.push_back(d);
      }
      check_hull(ConvexHull(ball), ball, 1e-8);
      const ConvexHull round(sphere);
      EXPECT_EQ(round.vertex_count(), n);
      check_hull(round, sphere, 1e-8);
    }
  }
}

TEST(NarrowHull, RoughPlanesDoublesAndFarAway) {
  Random random(4);
  for (const double noise : {0.0, 1e-15, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6}) {
    for (const double far : {0.0, 1e3}) {
      SCOPED_TRACE(testing::Message() << noise << ' ' << far);
      std::vector<Vec3> points = lattice(4);
      const std::size_t n = points.size();
      for (std::size_t k = 0; k < n; ++k) {
        points[k] += noise * direction(random) + Vec3(far, -far, far);
        points.push_back(points[k]);
      }
      const ConvexHull hull(points);
      EXPECT_GE(hull.vertex_count(), 8);
      EXPECT_TRUE(noise > 1e-8 || hull.face_count() == 6);
      for (int f = 0; f < hull.face_count(); ++f) {
        for (const Vec3& p : points) {
          EXPECT_LE(hull.plane(f).normal.dot(p) - hull.plane(f).offset, 1e-6);
        }
      }
    }
  }
}

TEST(NarrowHull, SameFromTheSamePoints) {
  Random random(5);
  std::vector<Vec3> points;
  for (int k = 0; k < 200; ++k) points.push_back(direction(random));
  const ConvexHull a(points), b(points);
  EXPECT_EQ(a.vertices(), b.vertices());
  ASSERT_EQ(a.face_count(), b.face_count());
  for (int f = 0; f < a.face_count(); ++f) {
    EXPECT_TRUE(std::ranges::equal(a.corners(f), b.corners(f)));
  }
}

TEST(NarrowHull, WithoutVolumeIsRefused) {
  const std::vector<Vec3> three = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  EXPECT_THROW(ConvexHull{three}, InputError);
  EXPECT_THROW(ConvexHull(std::vector<Vec3>(10, Vec3(1, 2, 3))), InputError);
  std::vector<Vec3> line, plane;
  for (int k = 0; k < 20; ++k) {
    line.emplace_back(k, 2 * k, -k);
    plane.emplace_back(k % 5, k / 5, 1e-8 * (k % 3));
  }
  EXPECT_THROW(ConvexHull{line}, InputError);
  EXPECT_THROW(ConvexHull{plane}, InputError);
  std::vector<Vec3> wrong = lattice(2);
  wrong[3].x() = std::nan("");
  EXPECT_THROW(ConvexHull{wrong}, InputError);
  wrong[3].x() = std::numeric_limits<double>::infinity();
  EXPECT_THROW(ConvexHull{wrong}, InputError);
}

// A hull of a box is the box: the same contacts, and faces with more corners than a patch has.
TEST(NarrowHull, CollidesAsTheShapeItIs) {
  Random random(6);
  const Box box{{0.5, 0.4, 0.3}};
  std::vector<Vec3> corners;
  for (const Vec3& p : lattice(2)) {
    corners.push_back((2 * p - Vec3::Ones()).cwiseProduct(box.half_lengths));
  }
  const Shape hull = std::make_shared<const ConvexHull>(corners);
  for (int k = 0; k < 500; ++k) {
    const Pose pose_a(direction(random), rotation(random));
    const Pose pose_b = placed_at_distance(box, pose_a, box, uniform(random, -0.02, 0.02), random);
    Manifold want, got;
    Cache cache, cache_too;
    ASSERT_EQ(collide(box, pose_a, box, pose_b, 0.02, want, cache),
              collide(hull, pose_a, hull, pose_b, 0.02, got, cache_too));
    EXPECT_TRUE(want.count == 0 || std::abs(deepest(got) - deepest(want)) < 4e-4);
  }
  const Shape drum = std::make_shared<const ConvexHull>(prism(100));
  Manifold manifold;
  Cache cache;
  ASSERT_TRUE(collide(drum, Pose({0, 0, 0.499}, Quaternion::Identity()), Plane{{0, 0, 1}, 0},
                      Pose(), 0.01, manifold, cache));
  EXPECT_EQ(manifold.count, 4);
  ASSERT_TRUE(collide(drum, Pose({0, 0, 0.999}, Quaternion::Identity()), drum, Pose(), 0.01,
                      manifold, cache));
  EXPECT_EQ(manifold.count, 4);
  EXPECT_NEAR(deepest(manifold), -0.001, 1e-9);
}

}  // namespace
}  // namespace substep::rigid
