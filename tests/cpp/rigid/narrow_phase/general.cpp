// All pairs of convex shapes at random poses against the definition: s(n), sampled and refined.
#include <gtest/gtest.h>

#include <cmath>

#include "shapes.h"
#include "substep/core/errors.h"

namespace substep::rigid {
namespace {

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

bool rounded(const Shape& shape) { return shape.index() == 0 || shape.index() == 2; }

// By how much a face may be worse than the best normal and still be taken.
double preference(const Shape& a, const Shape& b) { return rounded(a) || rounded(b) ? 1e-6 : 1e-2; }

// How far a shape reaches along n.
double reach(const Shape& shape, const Pose& pose, const Vec3& n) {
  return n.dot(pose.to_world(support_of(shape, pose.rotation.transpose() * n)));
}

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
        const Pose pose_a(direction(random_), rotation(random_));
        const Pose pose_b = placed_at_distance(a, pose_a, b, gap, random_);
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
          // Both points are of the shapes: no plane parts them.
          for (int j = 0; j < 50; ++j) {
            const Vec3 n = j == 0 ? manifold.normal : direction(random_);
            EXPECT_LT(n.dot(p.on_a), reach(a, pose_a, n) + 1e-9);
            EXPECT_LT(n.dot(p.on_b), reach(b, pose_b, n) + 1e-9);
          }
        }
        EXPECT_NEAR(least, s, 1e-9 + 2 * preference(a, b) * (manifold.count > 1));
      }
    }
  }
}

// The same contact whichever shape comes first, wherever both are, and whatever the cache holds.
TEST_F(NarrowGeneral, SwappedMovedAndCached) {
  const auto all = shapes(random_);
  for (const auto& [name_a, a] : all) {
    for (const auto& [name_b, b] : all) {
      Cache cache;
      for (int k = 0; k < 40; ++k) {
        SCOPED_TRACE(testing::Message() << name_a << ' ' << name_b << ' ' << k);
        const Pose pose_a(direction(random_), rotation(random_));
        const Pose pose_b =
            placed_at_distance(a, pose_a, b, uniform(random_, -0.05, 0.05), random_);
        Manifold manifold, swapped, moved, cached;
        Cache fresh, fresh_too, fresh_three;
        const double margin = 0.02;
        const bool touch = collide(a, pose_a, b, pose_b, margin, manifold, fresh);
        ASSERT_EQ(collide(b, pose_b, a, pose_a, margin, swapped, fresh_too), touch);
        const Pose motion(10 * direction(random_), rotation(random_));
        ASSERT_EQ(collide(a, motion * pose_a, b, motion * pose_b, margin, moved, fresh_three),
                  touch);
        ASSERT_EQ(collide(a, pose_a, b, pose_b, margin, cached, cache), touch);
        if (!touch) continue;
        EXPECT_NEAR(deepest(swapped), deepest(manifold), 1.2 * preference(a, b) + 1e-9);
        EXPECT_NEAR(deepest(moved), deepest(manifold), 1e-9);
        if (manifold.count == moved.count &&
            manifold.points[0].feature == moved.points[0].feature) {
          EXPECT_LT((motion.rotation * manifold.normal - moved.normal).norm(), 1e-9);
          EXPECT_LT((motion.to_world(manifold.points[0].on_a) - moved.points[0].on_a).norm(), 1e-9);
        }
        ASSERT_EQ(cached.count, manifold.count);
        for (int j = 0; j < cached.count; ++j) {
          EXPECT_EQ(cached.points[j].on_a, manifold.points[j].on_a);
          EXPECT_EQ(cached.points[j].on_b, manifold.points[j].on_b);
          EXPECT_EQ(cached.points[j].feature, manifold.points[j].feature);
        }
      }
    }
  }
}

// Scales from a tenth of a millimetre to ten kilometres.
TEST_F(NarrowGeneral, ScalesWithTheShapes) {
  for (const double scale : {1e-4, 1e-2, 1e2, 1e4}) {
    const std::vector<Shape> unit = {Sphere{0.45}, Capsule{0.3, 0.4}, Box{{0.5, 0.3, 0.4}},
                                     Cylinder{0.4, 0.35}};
    const std::vector<Shape> scaled = {Sphere{0.45 * scale}, Capsule{0.3 * scale, 0.4 * scale},
                                       Box{scale * Vec3(0.5, 0.3, 0.4)},
                                       Cylinder{0.4 * scale, 0.35 * scale}};
    for (std::size_t i = 0; i < unit.size(); ++i) {
      for (std::size_t j = 0; j < unit.size(); ++j) {
        for (int k = 0; k < 20; ++k) {
          const Pose pose_a(Vec3::Zero(), rotation(random_));
          const Pose pose_b =
              placed_at_distance(unit[i], pose_a, unit[j], uniform(random_, -0.1, 0.1), random_);
          Manifold want, got;
          Cache cache, cache_too;
          collide(unit[i], pose_a, unit[j], pose_b, 1, want, cache);
          collide(scaled[i], pose_a, scaled[j], Pose(scale * pose_b.position, pose_b.rotation),
                  scale, got, cache_too);
          EXPECT_NEAR(deepest(got) / scale, deepest(want), 1e-9) << i << ' ' << j << ' ' << k;
        }
      }
    }
  }
}

// A coin against a hall: 1 mm beside 1 km.
TEST_F(NarrowGeneral, TinyOnHuge) {
  const Shape floor = Box{{1000, 1000, 1}};
  for (const auto& [shape, half] :
       std::vector<std::pair<Shape, double>>{{Sphere{1e-3}, 1e-3},
                                             {Box{{1e-3, 2e-3, 1e-3}}, 1e-3},
                                             {Cylinder{1e-2, 1e-3}, 1e-3},
                                             {Capsule{1e-3, 0}, 1e-3}}) {
    Manifold manifold;
    Cache cache;
    const Pose pose({300, -700, 1 + half - 1e-6}, Quaternion::Identity());
    ASSERT_TRUE(collide(shape, pose, floor, Pose(), 1e-4, manifold, cache));
    EXPECT_LT((manifold.normal - Vec3(0, 0, -1)).norm(), 1e-12);
    for (int k = 0; k < manifold.count; ++k) {
      EXPECT_NEAR(manifold.points[k].separation, -1e-6, 1e-12);
    }
    EXPECT_EQ(manifold.count, shape.index() == 1 || shape.index() == 3 ? 4 : 1);
  }
}

// The same place, the same turn: some direction out of a hundred coincident ones, and no NaN.
TEST_F(NarrowGeneral, CoincidentAndInside) {
  for (const auto& [name_a, a] : shapes(random_)) {
    for (const auto& [name_b, b] : shapes(random_)) {
      SCOPED_TRACE(testing::Message() << name_a << ' ' << name_b);
      const Pose pose({1, 2, 3}, rotation(random_));
      for (const Pose& other : {pose, Pose(pose.position + Vec3(1e-12, 0, 0), pose.rotation),
                                Pose(pose.position, rotation(random_))}) {
        Manifold manifold;
        Cache cache;
        ASSERT_TRUE(collide(a, pose, b, other, 0.01, manifold, cache));
        EXPECT_NEAR(manifold.normal.norm(), 1, 1e-12);
        EXPECT_NEAR(deepest(manifold), separation(a, pose, b, other, manifold.normal),
                    2 * preference(a, b) + 1e-9);
        EXPECT_LT(deepest(manifold), -0.05);
      }
    }
  }
  // A small box inside a large one leaves by the nearest face.
  Manifold manifold;
  Cache cache;
  ASSERT_TRUE(collide(Box{{0.1, 0.1, 0.1}}, Pose({0.3, 0.7, 0.2}, Quaternion::Identity()),
                      Box{{1, 1, 1}}, Pose(), 0, manifold, cache));
  EXPECT_EQ(manifold.normal, Vec3(0, -1, 0));
  EXPECT_NEAR(deepest(manifold), -0.4, 1e-12);
  EXPECT_THROW(
      collide(Plane{{0, 0, 1}, 0}, Pose(), Plane{{0, 0, 1}, 0}, Pose(), 0, manifold, cache),
      InputError);
}

// Under a small motion corners keep their names, so that impulses are carried over.
TEST_F(NarrowGeneral, FeaturesPersistAtRest) {
  const auto hull = [] {
    std::vector<Vec3> p;
    for (int k = 0; k < 6; ++k) {
      const double angle = 1.0471975511965976 * k;
      for (const double z : {-0.4, 0.4})
        p.emplace_back(0.5 * std::cos(angle), 0.5 * std::sin(angle), z);
    }
    return std::make_shared<const ConvexHull>(p);
  }();
  const std::vector<std::pair<Shape, double>> all = {
      {Box{{0.5, 0.5, 0.4}}, 0.4}, {Cylinder{0.5, 0.4}, 0.4}, {hull, 0.4}};
  for (const auto& [a, half_a] : all) {
    for (const auto& [b, half_b] : all) {
      SCOPED_TRACE(testing::Message() << a.index() << ' ' << b.index());
      for (const double yaw : {0.0, 0.3}) {
        std::vector<std::uint32_t> names;
        for (int k = 0; k < 200; ++k) {  // trembles as a stack at rest does
          const auto small = [&] { return uniform(random_, -1e-7, 1e-7); };
          const Vec3 turn(small(), small(), yaw + small());
          const Pose pose(
              Vec3(0.0031 + small(), 0.0017 + small(), half_a + half_b - 1e-4 + small()),
              Quaternion(Eigen::AngleAxisd(turn.norm(), turn.normalized())));
          Manifold manifold;
          Cache cache;
          ASSERT_TRUE(collide(a, Pose(), b, pose, 0.01, manifold, cache));
          ASSERT_EQ(manifold.count, 4);
          std::vector<std::uint32_t> now;
          for (int j = 0; j < 4; ++j) now.push_back(manifold.points[j].feature);
          std::sort(now.begin(), now.end());
          if (k == 0) names = now;
          ASSERT_EQ(now, names) << yaw << ' ' << k;
        }
      }
    }
  }
}

}  // namespace
}  // namespace substep::rigid
