// Shapes at rest on each other: poses that tremble give points that tremble as much, in one place.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "shapes.h"
#include "substep/core/usize.h"
#include "substep/rigid/collision/mesh_contacts.h"

namespace substep::rigid {
namespace {

std::shared_ptr<const ConvexHull> upright_prism(int n) {
  std::vector<Vec3> points;
  for (int k = 0; k < n; ++k) {
    const double angle = 4 * kQuarter * k / n;
    for (const double z : {-0.4, 0.4})
      points.emplace_back(0.5 * std::cos(angle), 0.5 * std::sin(angle), z);
  }
  return std::make_shared<const ConvexHull>(points);
}

// Squares of side 1 / 2 in two triangles each.
std::shared_ptr<const TriangleMesh> flat_mesh() {
  constexpr int n = 8;
  std::vector<Vec3> vertices;
  std::vector<std::array<std::int32_t, 3>> faces;
  for (int k = 0; k < (n + 1) * (n + 1); ++k) {
    vertices.emplace_back(0.5 * (k % (n + 1)) - 2, 0.5 * (k / (n + 1)) - 2, 0);
  }
  for (int k = 0; k < n * n; ++k) {
    const int a = k / n * (n + 1) + k % n, b = a + 1, c = b + n + 1, d = c - 1;
    faces.push_back({a, b, c}), faces.push_back({a, c, d});
  }
  return std::make_shared<const TriangleMesh>(vertices, faces);
}

Mat3 about(double angle, const Vec3& axis) { return Eigen::AngleAxisd(angle, axis).matrix(); }

struct Rest {
  const char* name;
  Shape ground, body;
  Vec3 position;  // of the body
  Mat3 rotation;
  int points;
  Mat3 of_ground = Mat3::Identity();
};

std::vector<Rest> rests() {
  const Vec3 x = Vec3::UnitX(), y = Vec3::UnitY(), z = Vec3::UnitZ();
  const Shape plane = Plane{z, 0}, mesh = flat_mesh(), slab = Box{{3, 3, 0.5}};
  const Shape cube = Box{{0.5, 0.5, 0.5}}, capsule = Capsule{0.2, 0.5}, drum = Cylinder{0.5, 0.4};
  const Shape roll = Cylinder{0.2, 0.6}, hexagon = upright_prism(6), round = upright_prism(40);
  const Mat3 lying = about(kQuarter, x), across = about(kQuarter, y), yaw = about(0.3, z);
  const Mat3 upright = Mat3::Identity();
  const double reach = std::sqrt(0.5);
  return {
      {"box on plane", plane, cube, {0, 0, 0.5}, yaw, 4},
      {"box on box, alike", cube, cube, {0, 0, 1}, upright, 4},
      {"box on box, half over", cube, cube, {0.5, 0, 1}, upright, 4},
      {"box on box, shifted", cube, cube, {0.2, 0.3, 1}, upright, 4},
      {"box on box, turned", cube, cube, {0.01, 0.02, 1}, yaw, 4},
      {"box on box, octagon", cube, cube, {0, 0, 1}, about(kQuarter / 2, z), 4},
      {"box over the edge of a slab", slab, cube, {3, 0, 1}, upright, 4},
      {"edge of a box on a box", cube, cube, {0.1, 0, 0.5 + reach}, about(kQuarter / 2, x), 2},
      {"edge on edge",
       cube,
       cube,
       {0.1, 0, 2 * reach},
       about(kQuarter / 2, y),
       1,
       about(kQuarter / 2, x)},
      {"capsule on a slab", slab, capsule, {0, 0, 0.7}, lying, 2},
      {"capsule over the edge", slab, capsule, {0, 3, 0.7}, lying, 2},
      {"capsule beside an edge", cube, capsule, {0.6, 0, 0.5 + std::sqrt(0.03)}, lying, 2},
      {"capsule on mesh", mesh, capsule, {0.13, 0.17, 0.2}, lying, 2},
      {"capsule on upright_prism", hexagon, capsule, {0.02, 0.01, 0.6}, lying, 2},
      {"capsule on capsule", capsule, capsule, {0, 0.1, 0.4}, lying, 2, lying},
      {"capsule across capsule", capsule, capsule, {0, 0.1, 0.4}, across, 1, lying},
      {"cylinder on plane", plane, drum, {0, 0, 0.4}, yaw, 4},
      {"cylinder on slab", slab, drum, {0, 0, 0.9}, yaw, 4},
      {"cylinder over an edge", cube, drum, {0.5, 0, 0.9}, yaw, 4},
      {"cylinder on cylinder", drum, drum, {0.1, 0.05, 0.8}, yaw, 4},
      {"cylinder on mesh", mesh, drum, {0.1, 0.2, 0.4}, yaw, 4},
      {"cylinder lies on plane", plane, roll, {0, 0, 0.2}, lying, 2},
      {"cylinder lies on a box", cube, roll, {0, 0, 0.7}, lying, 2},
      {"cylinder lies on mesh", mesh, roll, {0.1, 0.2, 0.2}, lying, 2},
      {"cylinder lies on cylinder", roll, roll, {0.1, 0.1, std::sqrt(0.15)}, lying, 2, lying},
      {"cylinder across cylinder", roll, roll, {0.1, 0.1, 0.4}, across, 1, lying},
      {"upright_prism on slab", slab, hexagon, {0, 0, 0.9}, yaw, 4},
      {"upright_prism on upright_prism", hexagon, hexagon, {0.01, 0, 0.8}, yaw, 4},
      {"round upright_prism on upright_prism", round, round, {0.1, 0, 0.8}, yaw, 4},
      {"upright_prism on mesh", mesh, hexagon, {0.1, 0.2, 0.4}, yaw, 4},
      {"box on mesh", mesh, cube, {0.1, 0.2, 0.5}, yaw, 4},
      {"box on mesh, alike", mesh, cube, {0.25, 0.25, 0.5}, upright, 4},
  };
}

std::vector<Vec3> points(const Rest& rest, const Pose& pose) {
  const Pose ground(Vec3::Zero(), rest.of_ground);
  std::vector<Manifold> manifolds;
  if (const auto* mesh = std::get_if<std::shared_ptr<const TriangleMesh>>(&rest.ground)) {
    collide_mesh(rest.body, pose, **mesh, ground, 0.01, manifolds);
  } else {
    Cache cache;
    collide(rest.ground, ground, rest.body, pose, 0.01, manifolds.emplace_back(), cache);
  }
  std::vector<Vec3> on_body;
  for (const Manifold& manifold : manifolds) {
    for (int k = 0; k < manifold.count; ++k) on_body.push_back(manifold.points[k].on_b);
  }
  return on_body;
}

double farthest(const std::vector<Vec3>& from, const std::vector<Vec3>& to) {
  double far = 0;
  for (const Vec3& p : from) {
    double near = std::numeric_limits<double>::infinity();
    for (const Vec3& q : to) near = std::min(near, (p - q).norm());
    far = std::max(far, near);
  }
  return far;
}

TEST(NarrowRest, PointsTrembleAsThePosesDo) {
  for (const Rest& rest : rests()) {
    for (const double small : {1e-9, 1e-6, 1e-4}) {
      SCOPED_TRACE(testing::Message() << rest.name << ' ' << small);
      Random random(5);
      const auto tremble = [&] {
        const double u = uniform(random, -small, small), v = uniform(random, -small, small);
        return Vec3(u, v, uniform(random, -small, small));
      };
      const Pose still(rest.position - Vec3(0, 0, 1e-3), rest.rotation);
      const std::vector<Vec3> want = points(rest, still);
      ASSERT_EQ(want.size(), usize(rest.points));
      for (int k = 0; k < 100; ++k) {
        const Vec3 turn = tremble();
        const Pose pose(still.position + tremble(),
                        Mat3(about(turn.norm(), turn.normalized()) * still.rotation));
        const std::vector<Vec3> got = points(rest, pose);
        ASSERT_EQ(got.size(), want.size()) << k;
        ASSERT_LT(std::max(farthest(got, want), farthest(want, got)), 10 * small) << k;
      }
    }
  }
}

}  // namespace
}  // namespace substep::rigid
