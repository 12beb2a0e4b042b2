// Cylinders: normals by the condition that s(n) is stationary, and closed forms.
#include <gtest/gtest.h>

#include <cmath>

#include "shapes.h"
#include "substep/rigid/collision/convex_contacts.h"
#include "substep/rigid/shapes/view.h"

namespace substep::rigid {
namespace {

// Of length 1, along each axis that lies along the contact.
std::vector<Vec3> lines_across(const Vec3& n, const Vec3& u, const Vec3& v) {
  std::vector<Vec3> lines;
  if (std::abs(n.dot(u)) < 1e-9) lines.push_back(u);
  if (std::abs(n.dot(v)) < 1e-9) {
    const Vec3 e = lines.empty() ? v : Vec3(v - v.dot(u) * u);
    if (e.norm() > 1e-6) lines.push_back(e.normalized());
  }
  return lines;
}

// w = y - x between the points farthest towards each other is along n, up to what is along lines
// that lie in both planes: 1e-11 where s itself to 1e-9 would allow 3e-5. Sizes up to 1 : 100.
TEST(NarrowCurved, NormalsAreStationary) {
  Random random(3);
  int rims = 0, sides = 0;
  for (int k = 0; k < 20000; ++k) {
    const double ratio = std::pow(10.0, uniform(random, -2, 2));
    const auto length = [&](double scale) { return scale * uniform(random, 0.1, 1); };
    const Cylinder a{length(1), length(1)}, b{length(ratio), length(ratio)};
    const double size = std::min({a.radius, a.half_length, b.radius, b.half_length});
    const double gap = uniform(random, -0.3, 0.05) * size;
    const Pose pose_a(direction(random), rotation(random));
    Pose pose_b = placed_at_distance(a, pose_a, b, gap, random);
    if (k % 7 == 0) {  // axes parallel
      pose_b = pose_a;
      const Vec3 d = direction(random);
      pose_b.position += (gap - separation(a, pose_a, b, pose_b, d)) * d;
    }
    const View<Cylinder> view_a(a), view_b(b);
    const Axis axis = best_axis({view_a.convex, view_b.convex, pose_b.relative_to(pose_a)}, 1e9);
    const Vec3 n = pose_a.rotation * axis.normal;
    ASSERT_NEAR(n.norm(), 1, 1e-12);
    ASSERT_NEAR(separation(a, pose_a, b, pose_b, n), axis.separation, 1e-12 * (1 + ratio));
    const Vec3 u = pose_a.rotation.col(2), v = pose_b.rotation.col(2);
    if (n.cross(u).norm() < 1e-4 || n.cross(v).norm() < 1e-4) continue;  // a cap
    Vec3 w = pose_b.to_world(b.support(-(pose_b.rotation.transpose() * n))) -
             pose_a.to_world(a.support(pose_a.rotation.transpose() * n));
    w -= n.dot(w) * n;
    const std::vector<Vec3> lines = lines_across(n, u, v);
    for (const Vec3& line : lines) w -= line.dot(w) * line;
    ASSERT_LT(w.norm(), 1e-11 * (1 + ratio)) << k;
    ++(lines.empty() ? rims : sides);
  }
  EXPECT_GT(rims, 500);
  EXPECT_GT(sides, 5000);
}

TEST(NarrowCurved, ClosedForms) {
  Random random(4);
  for (int k = 0; k < 2000; ++k) {
    const Cylinder a{uniform(random, 0.1, 1), uniform(random, 0.5, 2)};
    const Cylinder b{uniform(random, 0.1, 1), uniform(random, 0.5, 2)};
    const double gap = uniform(random, -0.05, 0.05);
    const Pose pose(direction(random), rotation(random));
    const View<Cylinder> view_a(a), view_b(b);
    const auto expect = [&](const Pose& pose_b, const Vec3& normal, double separation) {
      const Axis axis =
          best_axis({view_a.convex, view_b.convex, (pose * pose_b).relative_to(pose)}, 1e9);
      ASSERT_LT((axis.normal - normal).norm(), 1e-12) << k;
      ASSERT_NEAR(axis.separation, separation, 1e-14) << k;
    };
    // Side by side: across the axes.
    const double angle = uniform(random, -3, 3);
    const Vec3 out(std::cos(angle), std::sin(angle), 0);
    expect(Pose((a.radius + b.radius + gap) * out + 0.3 * Vec3::UnitZ(), Mat3::Identity()), out,
           gap);
    // Crossing: along the common normal of the axes.
    const Quaternion turn(Eigen::AngleAxisd(uniform(random, 0.2, 2.9), out));
    expect(Pose((a.radius + b.radius + gap) * out, turn), out, gap);
    // A rim over a rim, apart, with the axes in one plane: from point to point.
    const Vec3 beyond(0.03, 0, 0.04);
    expect(Pose(Vec3(a.radius + b.radius, 0, a.half_length + b.half_length) + beyond,
                Mat3::Identity()),
           beyond / 0.05, 0.05);
  }
}

// Axes in one line: all directions across are as good, and one of them is found.
TEST(NarrowCurved, Coaxial) {
  const Shape thin = Capsule{3e-4, 0.4}, drum = Cylinder{0.4, 0.5};
  for (const Pose& pose : {Pose(), Pose({1e-12, 0, 0}, Mat3::Identity())}) {
    Manifold manifold;
    Cache cache;
    ASSERT_TRUE(collide(thin, pose, drum, Pose(), 0, manifold, cache));
    EXPECT_NEAR(manifold.normal.z(), 0, 1e-12);
    EXPECT_NEAR(deepest(manifold), -0.4003, 1e-9);
  }
}

// A ball and a capsule whose axis it meets: pushed out across the axis, exactly.
TEST(NarrowCurved, AcrossTheAxisFromWithin) {
  Random random(5);
  for (int k = 0; k < 200; ++k) {
    const Pose capsule(1e3 * direction(random), rotation(random));
    const Vec3 off = std::pow(10.0, uniform(random, -16, -3)) * direction(random);
    Manifold manifold;
    Cache cache;
    ASSERT_TRUE(collide(Sphere{0.2}, Pose(capsule.position + off, Mat3::Identity()),
                        Capsule{0.3, 0.4}, capsule, 0, manifold, cache));
    EXPECT_NEAR(manifold.normal.norm(), 1, 1e-12);
    EXPECT_NEAR(manifold.normal.dot(capsule.rotation.col(2)), 0, 1e-12);
    ASSERT_TRUE(collide(Capsule{0.2, 0.4}, Pose(capsule.position + off, rotation(random)),
                        Capsule{0.3, 0.4}, capsule, 0, manifold, cache));
    EXPECT_NEAR(manifold.normal.dot(capsule.rotation.col(2)), 0, 1e-12);
  }
}

}  // namespace
}  // namespace substep::rigid
