#include "substep/rigid/distance/ray_cast.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "shapes.h"
#include "substep/core/usize.h"

namespace {

using substep::usize;

using namespace substep::rigid;
using test::Random;

// How far out of the shape a point of its frame is, by the largest of its constraints; the scale of
// the distance near the surface.
struct Outside {
  const Vec3& p;
  double operator()(const Sphere& s) const { return p.norm() - s.radius; }
  double operator()(const Box& b) const { return (p.cwiseAbs() - b.half_lengths).maxCoeff(); }
  double operator()(const Capsule& c) const {
    const double along = std::clamp(p.z(), -c.half_length, c.half_length);
    return (p - Vec3(0, 0, along)).norm() - c.radius;
  }
  double operator()(const Cylinder& c) const {
    return std::max(p.head<2>().norm() - c.radius, std::abs(p.z()) - c.half_length);
  }
  double operator()(const Plane& plane) const { return plane.normal.dot(p) - plane.offset; }
  double operator()(const std::shared_ptr<const ConvexHull>& hull) const {
    double most = -1e300;
    for (int f = 0; f < hull->face_count(); ++f) {
      most = std::max(most, hull->plane(f).normal.dot(p) - hull->plane(f).offset);
    }
    return most;
  }
  template <class Other>  // every_shape.cpp has them
  double operator()(const Other&) const {
    return std::numeric_limits<double>::quiet_NaN();
  }
};
double outside(const Shape& shape, const Vec3& p) { return std::visit(Outside{p}, shape); }

TEST(RayCast, EntersWhereTheConstraintsSay) {
  Random random(1);
  int hits = 0, misses = 0, inside = 0;
  for (int trial = 0; trial < 6000; ++trial) {
    Shape shape = random.shape(trial);
    if (trial % 7 == 0) shape = Plane{random.direction(), random.number(-1, 1)};
    const Pose pose = random.pose(2);
    const Vec3 from = random.vector(4), to = pose.position + random.vector(1);
    const Ray ray{from, (to - from).normalized(), random.number(0, 8)};
    const auto hit = ray_cast(shape, pose, ray);
    const auto out = [&](double t) { return outside(shape, pose.to_local(ray.at(t))); };
    if (std::isnan(out(0))) continue;
    if (out(0) < 0) {
      EXPECT_FALSE(hit) << trial;
      ++inside;
      continue;
    }
    const double end = hit ? hit->distance : ray.length;
    EXPECT_LE(end, ray.length);
    for (int k = 0; k < 100; ++k) EXPECT_GT(out(end * k / 100), -1e-9) << trial;
    if (!hit) {
      ++misses;
      continue;
    }
    ++hits;
    EXPECT_GE(hit->distance, 0);
    EXPECT_NEAR(out(end), 0, 1e-12) << trial;
    EXPECT_NEAR(hit->normal.norm(), 1, 1e-12);
    EXPECT_LE(hit->normal.dot(ray.direction), 1e-6);
    // The normal is the gradient.
    const Vec3 local = pose.to_local(ray.at(end)), n = pose.rotation.transpose() * hit->normal;
    EXPECT_NEAR(outside(shape, local + 1e-7 * n), 1e-7, 1e-12) << trial;
  }
  EXPECT_GT(hits, 1000);
  EXPECT_GT(misses, 1000);
  EXPECT_GT(inside, 100);
}

TEST(RayCast, ClosedForms) {
  const Pose home;
  const auto along_x = [&](const Shape& shape, double y, double z) {
    return ray_cast(shape, home, {Vec3(-10, y, z), Vec3::UnitX()});
  };
  EXPECT_DOUBLE_EQ(along_x(Sphere{5}, 3, 0)->distance, 6);
  EXPECT_TRUE(along_x(Sphere{5}, 3, 0)->normal.isApprox(Vec3(-0.8, 0.6, 0), 1e-15));
  EXPECT_DOUBLE_EQ(along_x(Box{Vec3(1, 2, 3)}, 2, -3)->distance, 9);  // along an edge
  EXPECT_FALSE(along_x(Box{Vec3(1, 2, 3)}, 2.0001, 0));
  EXPECT_DOUBLE_EQ(along_x(Capsule{5, 2}, 3, 1)->distance, 6);
  EXPECT_DOUBLE_EQ(along_x(Capsule{5, 2}, 0, 6)->distance, 7);
  EXPECT_DOUBLE_EQ(along_x(Cylinder{5, 2}, 3, 2)->distance, 6);
  EXPECT_FALSE(along_x(Cylinder{5, 2}, 3, 2.0001));
  EXPECT_DOUBLE_EQ(
      ray_cast(Plane{Vec3::UnitZ(), 1}, home, {Vec3(0, 0, 5), Vec3(0.6, 0, -0.8)})->distance, 5);
  EXPECT_FALSE(ray_cast(Plane{Vec3::UnitZ(), 1}, home, {Vec3(0, 0, 5), Vec3(1, 0, 0)}));
  EXPECT_FALSE(ray_cast(Plane{Vec3::UnitZ(), 1}, home, {Vec3(0, 0, 0), Vec3(0, 0, 1)}));
  // Not longer than it is, and exactly as long.
  EXPECT_FALSE(ray_cast(Sphere{1}, home, {Vec3(-3, 0, 0), Vec3::UnitX(), 1.999999}));
  EXPECT_TRUE(ray_cast(Sphere{1}, home, {Vec3(-3, 0, 0), Vec3::UnitX(), 2}));
  // Behind, and from far away: a small ball at 1e6 radii.
  EXPECT_FALSE(ray_cast(Sphere{1}, home, {Vec3(3, 0, 0), Vec3::UnitX()}));
  EXPECT_NEAR(ray_cast(Sphere{1}, home, {Vec3(-1e6, 0.6, 0), Vec3::UnitX()})->distance, 1e6 - 0.8,
              1e-9);
}

// A bumpy square of triangles.
std::shared_ptr<const TriangleMesh> terrain(int cells, Random& random) {
  std::vector<Vec3> vertices;
  std::vector<std::array<std::int32_t, 3>> faces;
  for (int i = 0; i <= cells; ++i) {
    for (int j = 0; j <= cells; ++j) vertices.push_back({i * 1.0, j * 1.0, random.number(0, 1)});
  }
  for (std::int32_t i = 0; i < cells; ++i) {
    for (std::int32_t j = 0; j < cells; ++j) {
      const std::int32_t a = i * (cells + 1) + j, b = a + cells + 1;
      faces.push_back({a, b, b + 1});
      faces.push_back({a, b + 1, a + 1});
    }
  }
  return std::make_shared<const TriangleMesh>(vertices, faces);
}

TEST(RayCast, MeshesAgainstEachTriangleAndThroughNoEdge) {
  Random random(2);
  const auto mesh = terrain(12, random);
  const Pose pose = random.pose(3);
  for (int trial = 0; trial < 2000; ++trial) {
    // Down to a point of the square; every other to a vertex or the middle of an edge.
    Vec3 target(random.number(1, 11), random.number(1, 11), 0.5);
    if (trial % 2 == 1) {
      const auto v = usize(random.number(14, 140));
      target = mesh->vertices()[v];
      if (trial % 4 == 1) target = (target + mesh->vertices()[v + 1]) / 2;
      if (target.y() < 1 || target.y() > 11) continue;
    }
    Vec3 down = random.vector(1);
    down.z() = -3;
    const Ray local{target - 2 * down, down.normalized()};
    const Ray ray{pose.to_world(local.origin), pose.rotation * local.direction};
    const auto hit = ray_cast(mesh, pose, ray);
    ASSERT_TRUE(hit) << trial;
    double nearest = 1e300;
    for (int t = 0; t < mesh->triangle_count(); ++t) {
      const Vec3& n = mesh->normal(t);
      const double rate = n.dot(local.direction);
      if (rate >= 0) continue;
      Vec3 corner[3];
      for (int k = 0; k < 3; ++k) {
        corner[k] = mesh->vertices()[usize(mesh->face(t)[usize(k)])];
      }
      const double distance = n.dot(corner[0] - local.origin) / rate;
      const Vec3 at = local.at(distance);
      bool within = distance >= 0;
      for (int k = 0; k < 3; ++k) {
        within &= n.dot((corner[(k + 1) % 3] - corner[k]).cross(at - corner[k])) > -1e-9;
      }
      if (within) nearest = std::min(nearest, distance);
    }
    EXPECT_NEAR(hit->distance, nearest, 1e-9) << trial;
    EXPECT_LT(hit->normal.dot(ray.direction), 0);
    // From behind it goes through.
    EXPECT_FALSE(ray_cast(mesh, pose, {ray.at(100), -ray.direction}));
  }
}

}  // namespace
