// Shapes on meshes of triangles, beside planes and boxes that have the same surface.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

#include "shapes.h"
#include "substep/core/errors.h"
#include "substep/rigid/collision/mesh_contacts.h"

namespace substep::rigid {
namespace {

using Faces = std::vector<std::array<std::int32_t, 3>>;

// n x n squares of side 1 / 2 over [-n/4, n/4]^2, with diagonals either way; height(x, y).
template <class Height>
TriangleMesh grid(int n, Height&& height) {
  std::vector<Vec3> vertices;
  Faces faces;
  for (int j = 0; j <= n; ++j) {
    for (int i = 0; i <= n; ++i) {
      const double x = 0.5 * i - 0.25 * n, y = 0.5 * j - 0.25 * n;
      vertices.emplace_back(x, y, height(x, y));
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i, b = a + 1, c = b + n + 1, d = c - 1;
      if ((i * 7 + j * 3) % 2 == 0) {
        faces.push_back({a, b, c}), faces.push_back({a, c, d});
      } else {
        faces.push_back({a, b, d}), faces.push_back({b, c, d});
      }
    }
  }
  return TriangleMesh(vertices, faces);
}

TriangleMesh box_mesh(const Vec3& h) {
  std::vector<Vec3> vertices;
  for (int k = 0; k < 8; ++k) {
    vertices.emplace_back(k & 1 ? h.x() : -h.x(), k & 2 ? h.y() : -h.y(), k & 4 ? h.z() : -h.z());
  }
  const int quads[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                           {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
  Faces faces;
  for (const auto& q : quads) {
    faces.push_back({q[0], q[1], q[2]}), faces.push_back({q[0], q[2], q[3]});
  }
  return TriangleMesh(vertices, faces);
}

TEST(NarrowMesh, FlatGroundIsAPlane) {
  Random random(11);
  const TriangleMesh mesh = grid(16, [](double, double) { return 0.0; });
  const Shape plane = Plane{{0, 0, 1}, 0};
  const Pose ground(direction(random), rotation(random));
  for (const auto& [name, shape] : shapes(random)) {
    for (int k = 0; k < 300; ++k) {
      SCOPED_TRACE(testing::Message() << name << ' ' << k);
      // Upright, lying or turned anyhow, a little in the ground or above it.
      Quaternion q = rotation(random);
      if (k % 3 == 0) q = Quaternion(Eigen::AngleAxisd(uniform(random, 0, 6), Vec3::UnitZ()));
      if (k % 3 == 1) {
        q = Quaternion(Eigen::AngleAxisd(uniform(random, 0, 6), Vec3::UnitZ())) *
            Quaternion(Eigen::AngleAxisd(std::acos(0.0), Vec3::UnitX()));
      }
      Pose pose(Vec3(uniform(random, -2, 2), uniform(random, -2, 2), 0), q);
      pose.position.z() = -support_of(shape, pose.rotation.transpose() * Vec3(0, 0, -1))
                               .dot(pose.rotation.transpose() * Vec3::UnitZ()) +
                          uniform(random, -0.02, 0.01);
      const Pose placed = ground * pose;
      Manifold want;
      Cache cache;
      collide(shape, placed, plane, ground, 0.011, want, cache);
      std::vector<Manifold> got;
      collide_mesh(shape, placed, mesh, ground, 0.011, got);
      ASSERT_EQ(got.size(), 1u);
      EXPECT_LT((got[0].normal - want.normal).norm(), 1e-12);
      ASSERT_GE(got[0].count, k % 3 == 2 ? 1 : std::min(want.count, 3));
      EXPECT_NEAR(deepest(got[0]), deepest(want), 1e-5);
      for (int j = 0; j < got[0].count; ++j) {
        const ContactPoint& p = got[0].points[j];
        EXPECT_NEAR(ground.to_local(p.on_b).z(), 0, 1e-12);
        EXPECT_LT((p.on_b - p.on_a - p.separation * got[0].normal).norm(), 1e-12);
      }
    }
  }
}

// What an inner edge would do to a box that slides over it: a normal that is not up.
TEST(NarrowMesh, NothingCatchesOnInnerEdges) {
  const TriangleMesh mesh = grid(16, [](double x, double) { return -0.3 * std::abs(x); });
  const double slope = std::atan(0.3);
  for (const Shape& shape : {Shape(Box{{0.3, 0.2, 0.1}}), Shape(Sphere{0.1}),
                             Shape(Capsule{0.1, 0.2}), Shape(Cylinder{0.2, 0.1})}) {
    const Vec3 up(std::sin(slope), 0, std::cos(slope));
    for (int k = 0; k < 2000; ++k) {  // down the slope x > 0, 3 mm in it
      const double x = 0.6 + 1e-3 * k, y = 0.7 - 7e-4 * k;
      const Pose pose(Vec3(x, y, -0.3 * x) + (0.1 - 0.003) * up,
                      Quaternion(Eigen::AngleAxisd(slope, Vec3::UnitY())));
      if (std::holds_alternative<Capsule>(shape)) {
        // (standing: its lower end is 0.2 further down)
        const Pose higher(pose.position + 0.2 * up, pose.rotation);
        std::vector<Manifold> got;
        collide_mesh(shape, higher, mesh, Pose(), 0.01, got);
        ASSERT_EQ(got.size(), 1u);
        ASSERT_LT((got[0].normal + up).norm(), 1e-6) << k;
        continue;
      }
      std::vector<Manifold> got;
      collide_mesh(shape, pose, mesh, Pose(), 0.01, got);
      ASSERT_EQ(got.size(), 1u) << k;
      ASSERT_LT((got[0].normal + up).norm(), 1e-6) << k;
      ASSERT_NEAR(deepest(got[0]), -0.003, 1e-9) << k;
      ASSERT_EQ(got[0].count, std::holds_alternative<Sphere>(shape) ? 1 : 4) << k;
    }
  }
}

// Corners keep their names from triangle to triangle.
TEST(NarrowMesh, FeaturesPersistAcrossTriangles) {
  const TriangleMesh mesh = grid(16, [](double, double) { return 0.0; });
  std::vector<std::uint32_t> names;
  for (int k = 0; k < 1000; ++k) {
    std::vector<Manifold> got;
    collide_mesh(Box{{0.3, 0.2, 0.1}},
                 Pose({-1 + 2e-3 * k, 0.7 - 1e-3 * k, 0.099}, Mat3::Identity()), mesh, Pose(), 0.01,
                 got);
    ASSERT_EQ(got.size(), 1u);
    ASSERT_EQ(got[0].count, 4);
    std::vector<std::uint32_t> now;
    for (const ContactPoint& p : got[0].points) now.push_back(p.feature);
    std::sort(now.begin(), now.end());
    if (k == 0) names = now;
    ASSERT_EQ(now, names) << k;
  }
}

// Ten kilometres out on large triangles it is as on a plane.
TEST(NarrowMesh, FarOutOnLargeGround) {
  const double far = 1e4;
  const std::vector<Vec3> corners = {
      {-far, -far, 0}, {far, -far, 0}, {far, far, 0}, {-far, far, 0}};
  const TriangleMesh mesh(corners, Faces{{0, 1, 2}, {0, 2, 3}});
  for (const Shape& shape :
       {Shape(Box{{0.2, 0.2, 0.1}}), Shape(Cylinder{0.2, 0.1}), Shape(Sphere{0.1})}) {
    std::vector<Manifold> got;
    collide_mesh(shape, Pose({9000.1, 8999.9, 0.0995}, Mat3::Identity()), mesh, Pose(), 0.01, got);
    ASSERT_EQ(got.size(), 1u);
    EXPECT_LT((got[0].normal - Vec3(0, 0, -1)).norm(), 1e-12);
    EXPECT_EQ(got[0].count, shape.index() == 0 ? 1 : 4);
    EXPECT_NEAR(deepest(got[0]), -5e-4, 1e-9);
  }
}

TEST(NarrowMesh, ABallInAValleyTouchesBothSides) {
  const TriangleMesh mesh = grid(8, [](double x, double) { return std::abs(x); });
  const double radius = 0.2;
  std::vector<Manifold> got;
  collide_mesh(Sphere{radius}, Pose({0, 0.1, radius * std::sqrt(2.0) - 0.001}, Mat3::Identity()),
               mesh, Pose(), 0.01, got);
  ASSERT_EQ(got.size(), 2u);
  for (const Manifold& manifold : got) {
    EXPECT_NEAR(std::abs(manifold.normal.x()), std::sqrt(0.5), 1e-12);
    EXPECT_NEAR(manifold.normal.z(), -std::sqrt(0.5), 1e-12);
    ASSERT_EQ(manifold.count, 1);
    EXPECT_NEAR(manifold.points[0].separation, -0.001 * std::sqrt(0.5), 1e-12);
  }
}

// The surface of a box is a box to what is outside of it: corners and edges are felt.
TEST(NarrowMesh, AClosedMeshIsTheSolid) {
  Random random(5);
  const Box solid{{0.5, 0.4, 0.6}};
  const TriangleMesh mesh = box_mesh(solid.half_lengths);
  const Pose placed(direction(random), rotation(random));
  for (const auto& [name, shape] : shapes(random)) {
    for (int k = 0; k < 200; ++k) {
      SCOPED_TRACE(testing::Message() << name << ' ' << k);
      const Pose pose =
          placed_at_distance(solid, placed, shape, uniform(random, -5e-3, 0.2), random);
      Manifold want;
      Cache cache;
      const bool touch = collide(shape, pose, solid, placed, 0.05, want, cache);
      std::vector<Manifold> got;
      collide_mesh(shape, pose, mesh, placed, 0.05, got);
      double least = std::numeric_limits<double>::infinity();
      for (const Manifold& m : got) least = std::min(least, deepest(m));
      if (!touch || deepest(want) > 0.045) continue;
      ASSERT_FALSE(got.empty());
      EXPECT_NEAR(least, deepest(want), 2e-3);
    }
  }
}

// On a finely curved surface a box has few normals, and is held where it is deepest: at the top of
// a dome, and on the rim of a bowl at four sides.
TEST(NarrowMesh, FinelyCurvedGroundGivesFewManifolds) {
  for (const double curvature : {-0.2, 0.2}) {
    constexpr int n = 200;
    std::vector<Vec3> vertices;
    Faces faces;
    for (int k = 0; k < (n + 1) * (n + 1); ++k) {
      const double x = 0.01 * (k % (n + 1)) - 1, y = 0.01 * (k / (n + 1)) - 1;
      vertices.emplace_back(x, y, curvature * (x * x + y * y));
    }
    for (int k = 0; k < n * n; ++k) {
      const int a = k / n * (n + 1) + k % n, b = a + 1, c = b + n + 1, d = c - 1;
      faces.push_back({a, b, c}), faces.push_back({a, c, d});
    }
    const TriangleMesh mesh(vertices, faces);
    // Its bottom touches the top of the dome, or its corners the bowl, 5 mm deep.
    const double bottom = curvature > 0 ? curvature * 0.5 : 0;
    const Pose pose({0.0031, 0.0017, bottom + 0.5 - 0.005}, Mat3::Identity());
    std::vector<Manifold> got;
    collide_mesh(Box{{0.5, 0.5, 0.5}}, pose, mesh, Pose(), 0.02, got);
    ASSERT_GE(got.size(), 1u);
    EXPECT_LE(got.size(), 8u);
    double least = 1;
    for (const Manifold& m : got) {
      least = std::min(least, deepest(m));
      EXPECT_GE(m.count, 1);
      EXPECT_LT(m.normal.z(), -0.9);
      for (int k = 0; k < m.count; ++k) {
        const ContactPoint& p = m.points[k];
        EXPECT_LT((p.on_b - p.on_a - p.separation * m.normal).norm(), 1e-12);
      }
    }
    EXPECT_NEAR(least, -0.005, curvature > 0 ? 1e-3 : 2e-5);  // (the corners are not quite alike)
  }
}

TEST(NarrowMesh, OneSidedAndRefused) {
  const TriangleMesh mesh = grid(4, [](double, double) { return 0.0; });
  std::vector<Manifold> got;
  collide_mesh(Sphere{0.2}, Pose({0, 0, -0.1}, Mat3::Identity()), mesh, Pose(), 0.01, got);
  EXPECT_TRUE(got.empty());
  const std::vector<Vec3> corners = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 0, 0}};
  EXPECT_THROW(TriangleMesh(corners, Faces{}), InputError);
  EXPECT_THROW(TriangleMesh(corners, Faces{{0, 1, 4}}), InputError);
  EXPECT_THROW(TriangleMesh(corners, Faces{{0, 1, -1}}), InputError);
  EXPECT_THROW(TriangleMesh(corners, Faces{{0, 1, 3}}), InputError);
  const std::vector<Vec3> wrong = {{0, 0, 0}, {1, 0, 0}, {0, std::nan(""), 0}};
  EXPECT_THROW(TriangleMesh(wrong, Faces{{0, 1, 2}}), InputError);
}

}  // namespace
}  // namespace substep::rigid
