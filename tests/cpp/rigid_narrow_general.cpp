// All pairs of convex shapes at random poses against the definition: s(n), sampled and refined.
#include <gtest/gtest.h>

#include <random>

#include "substep/rigid/narrow_phase.h"

namespace substep::rigid {
namespace {

using Random = std::mt19937_64;

double uniform(Random& random, double low, double high) {
  return low + (high - low) * static_cast<double>(random() >> 11) * 0x1p-53;
}
Vec3 direction(Random& random) {
  while (true) {
    const Vec3 d(uniform(random, -1, 1), uniform(random, -1, 1), uniform(random, -1, 1));
    if (d.squaredNorm() < 1 && d.squaredNorm() > 0.01) return d.normalized();
  }
}
Quaternion rotation(Random& random) {
  return Quaternion(Eigen::AngleAxisd(uniform(random, 0, 3.1), direction(random)));
}

Vec3 support_of(const Shape& shape, const Vec3& d) {
  return std::visit(
      [&](const auto& s) -> Vec3 {
        if constexpr (std::is_same_v<decltype(s), const Plane&>) {
          return Vec3::Zero();
        } else {
          return support(s, d);
        }
      },
      shape);
}

// s(n) by the definition.
double separation(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                  const Vec3& n) {
  const Vec3 x = pose_a.to_world(support_of(a, pose_a.rotation.transpose() * n));
  const Vec3 y = pose_b.to_world(support_of(b, -(pose_b.rotation.transpose() * n)));
  return n.dot(y - x);
}

// The largest s(n): from many directions the best few, each refined by shrinking random steps.
double largest_separation(const Shape& a, const Pose& pose_a, const Shape& b, const Pose& pose_b,
                          Random& random) {
  const auto s = [&](const Vec3& n) { return separation(a, pose_a, b, pose_b, n); };
  std::vector<std::pair<double, Vec3>> tried;
  for (int k = 0; k < 2000; ++k) {
    const Vec3 n = direction(random);
    tried.emplace_back(s(n), n);
  }
  std::partial_sort(tried.begin(), tried.begin() + 8, tried.end(),
                    [](const auto& p, const auto& q) { return p.first > q.first; });
  double most = tried[0].first;
  for (int k = 0; k < 8; ++k) {
    auto [best, n] = tried[k];
    for (double step = 0.2; step > 1e-12; step *= 0.8) {
      for (int j = 0; j < 12; ++j) {
        const Vec3 m = (n + step * direction(random)).normalized();
        const double value = s(m);
        if (value > best) best = value, n = m;
      }
    }
    most = std::max(most, best);
  }
  return most;
}

std::shared_ptr<const ConvexHull> random_hull(Random& random, int points) {
  std::vector<Vec3> p(points);
  for (Vec3& x : p) x = 0.5 * direction(random).cwiseProduct(Vec3(1.2, 1, 0.7));
  return std::make_shared<const ConvexHull>(p);
}

std::vector<std::pair<const char*, Shape>> shapes(Random& random) {
  return {{"sphere", Sphere{0.45}},
          {"capsule", Capsule{0.3, 0.4}},
          {"box", Box{{0.5, 0.3, 0.4}}},
          {"cylinder", Cylinder{0.4, 0.35}},
          {"tetrahedron", random_hull(random, 4)},
          {"hull", random_hull(random, 30)}};
}

struct Case {
  Pose pose_a, pose_b;
};

// Random poses whose shapes are at a distance of about `gap` along a random direction.
Case random_case(const Shape& a, const Shape& b, double gap, Random& random) {
  Case c{Pose(direction(random), rotation(random)), Pose(Vec3::Zero(), rotation(random))};
  const Vec3 d = direction(random);
  c.pose_b.position = c.pose_a.position;
  c.pose_b.position += (gap - separation(a, c.pose_a, b, c.pose_b, d)) * d;
  return c;
}

bool rounded(const Shape& shape) { return shape.index() == 0 || shape.index() == 2; }

// By how much a face may be worse than the best normal and still be taken.
double preference(const Shape& a, const Shape& b) { return rounded(a) || rounded(b) ? 1e-6 : 6e-4; }

class NarrowGeneral : public testing::Test {
 protected:
  Random random_{7};
};

TEST_F(NarrowGeneral, SeparationIsTheLargestAlongAnyNormal) {
  const auto all = shapes(random_);
  for (const auto& [name_a, a] : all) {
    for (const auto& [name_b, b] : all) {
      for (const double gap : {0.2, 0.01, 1e-5, -1e-5, -0.01, -0.1, -0.3}) {
        SCOPED_TRACE(testing::Message() << name_a << ' ' << name_b << ' ' << gap);
        const auto [pose_a, pose_b] = random_case(a, b, gap, random_);
        const double want = largest_separation(a, pose_a, b, pose_b, random_);
        Manifold manifold;
        Cache cache;
        ASSERT_TRUE(collide(a, pose_a, b, pose_b, 1.0, manifold, cache));
        // The normal is as good as the best, up to the preference for faces.
        const double s = separation(a, pose_a, b, pose_b, manifold.normal);
        EXPECT_LT(want, s + preference(a, b) + 1e-9);
        // The deepest point has that separation.
        double least = 1e9;
        for (int k = 0; k < manifold.count; ++k) {
          const ContactPoint& p = manifold.points[k];
          least = std::min(least, p.separation);
          EXPECT_LT((p.on_b - p.on_a - p.separation * manifold.normal).norm(), 1e-12);
          EXPECT_GE(p.separation, s - 1e-9);
        }
        EXPECT_NEAR(least, s, 1e-9 + 1e-3 * (manifold.count > 1));
      }
    }
  }
}

}  // namespace
}  // namespace substep::rigid
