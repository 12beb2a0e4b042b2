#include "substep/pbd/contact/surface_pairs.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <set>

#include "substep/core/usize.h"
#include "substep/geometry/closest_points.h"

namespace {

using substep::usize;

using substep::Point;
using substep::geometry::closest_on_segments;
using substep::geometry::closest_on_triangle;
using substep::geometry::Vec3;
using substep::pbd::closest;
using substep::pbd::SurfacePair;
using substep::pbd::SurfacePairs;

class Random {
 public:
  Vec3 vector(double size = 1) { return {size * draw_(g_), size * draw_(g_), size * draw_(g_)}; }

 private:
  std::mt19937 g_{5};
  std::uniform_real_distribution<double> draw_{-1, 1};
};

// The least distance is where no small step within the primitive leads nearer (it is convex).
TEST(ClosestPoints, OfATriangleIsWhereNothingNearerIsNear) {
  Random random;
  for (int trial = 0; trial < 500; ++trial) {
    const Vec3 a = random.vector(), b = random.vector(), c = random.vector();
    const Vec3 p = random.vector(2);
    const auto w = closest_on_triangle(p, a, b, c);
    EXPECT_NEAR(w[0] + w[1] + w[2], 1, 1e-12);
    EXPECT_GE(std::min({w[0], w[1], w[2]}), -1e-12);
    const Vec3 q = w[0] * a + w[1] * b + w[2] * c;
    for (const Vec3& corner : {a, b, c}) EXPECT_LE((p - q).dot(corner - q), 1e-9);
  }
}

TEST(ClosestPoints, OfSegmentsAreWhereNothingNearerIsNear) {
  Random random;
  for (int trial = 0; trial < 500; ++trial) {
    const Vec3 a0 = random.vector(), a1 = random.vector(), b0 = random.vector();
    const Vec3 b1 = trial % 5 == 0 ? Vec3(b0 + 0.7 * (a1 - a0)) : random.vector();  // parallel
    const auto [s, t] = closest_on_segments(a0, a1, b0, b1);
    EXPECT_TRUE(s >= 0 && s <= 1 && t >= 0 && t <= 1);
    const Vec3 p = a0 + s * (a1 - a0), q = b0 + t * (b1 - b0);
    EXPECT_LE((q - p).dot(a0 - p), 1e-9);
    EXPECT_LE((q - p).dot(a1 - p), 1e-9);
    EXPECT_LE((p - q).dot(b0 - q), 1e-9);
    EXPECT_LE((p - q).dot(b1 - q), 1e-9);
  }
}

TEST(ClosestPoints, OfDegenerateParts) {
  const Vec3 o(0, 0, 0), x(1, 0, 0), y(0, 1, 0);
  EXPECT_EQ(closest_on_triangle(y, o, o, o)[0], 1);
  const auto flat = closest_on_triangle({0.25, 1, 0}, o, x, 2 * x);
  EXPECT_NEAR(flat[1] + 2 * flat[2], 0.25, 1e-12);
  EXPECT_EQ(closest_on_segments(o, o, y, y), (std::array<double, 2>{0, 0}));
  EXPECT_EQ(closest_on_segments(o, o, y - x, y + x), (std::array<double, 2>{0, 0.5}));
  EXPECT_EQ(closest_on_segments(y - x, y + x, o, o), (std::array<double, 2>{0.5, 0}));
}

using Key = std::array<std::int32_t, 5>;
Key key(const SurfacePair& p) { return {p.v[0], p.v[1], p.v[2], p.v[3], p.first}; }

bool apart(const SurfacePair& p) {
  return std::set<std::int32_t>(p.v.begin(), p.v.end()).size() == 4;
}

// All pairs of a list of triangles that are closer than `reach`, edges with the lower one first.
template <class Real>
std::set<Key> all_pairs(const std::vector<std::array<std::int32_t, 3>>& faces,
                        const std::vector<Point<Real>>& x, double reach) {
  std::set<std::array<std::int32_t, 2>> edges;
  std::set<std::int32_t> vertices;
  std::set<Key> found;
  const auto consider = [&](const SurfacePair& pair) {
    std::array<Vec3, 4> at;
    for (std::size_t k = 0; k < 4; ++k) {
      const Point<Real>& p = x[usize(pair.v[k])];
      at[k] = Vec3(p.x, p.y, p.z);
    }
    if (apart(pair) && closest(pair, at).d < reach) found.insert(key(pair));
  };
  for (const auto& f : faces) {
    for (std::size_t k = 0; k < 3; ++k) {
      edges.insert({std::min(f[k], f[(k + 1) % 3]), std::max(f[k], f[(k + 1) % 3])});
      vertices.insert(f[k]);
    }
  }
  for (const auto& e : edges) {
    for (const auto& f : edges) {
      if (e < f) consider({{e[0], e[1], f[0], f[1]}, 2});
    }
  }
  for (const std::int32_t v : vertices) {
    for (const auto& f : faces) consider({{v, f[0], f[1], f[2]}, 1});
  }
  return found;
}

template <class Real>
class SurfacePairsOf : public testing::Test {};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(SurfacePairsOf, Reals);

// A crumpled sheet, some of whose edges are thirty times as long as at rest.
TYPED_TEST(SurfacePairsOf, AreCompleteAndInOneOrder) {
  using Real = TypeParam;
  constexpr int n = 9;
  std::vector<std::array<std::int32_t, 3>> faces;
  std::vector<Vec3> rest;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      rest.emplace_back(i, j, 0);
      if (i + 1 == n || j + 1 == n) continue;
      const std::int32_t a = i * n + j;
      faces.push_back({a, a + n, a + n + 1});
      faces.push_back({a, a + n + 1, a + 1});
    }
  }
  Random random;
  std::vector<Point<Real>> x;
  for (const Vec3& r : rest) {
    const Vec3 p = (r[0] == 4 && r[1] == 4 ? Vec3(30, 10, 5) : Vec3(0.3 * r)) + random.vector(0.5);
    x.push_back({static_cast<Real>(p[0]), static_cast<Real>(p[1]), static_cast<Real>(p[2]), 0});
  }
  SurfacePairs<Real> kept(faces, rest);
  for (int step = 0; step < 6; ++step) {
    constexpr double kReach = 0.4;
    kept.update(x.data(), kReach, 1 + step % 3);
    std::set<Key> found;
    for (const auto& c : kept.candidates()) {
      EXPECT_TRUE(found.insert(key(c.pair)).second) << "twice";
      EXPECT_TRUE(apart(c.pair));
    }
    const std::set<Key> expected = all_pairs(faces, x, kReach);
    EXPECT_GT(expected.size(), 500u);
    EXPECT_TRUE(std::includes(found.begin(), found.end(), expected.begin(), expected.end()));
    // What a new list holds of the pairs in reach stands in the same order.
    SurfacePairs<Real> fresh(faces, rest);
    fresh.update(x.data(), kReach, 1);
    const auto in_reach = [&](const SurfacePairs<Real>& pairs) {
      std::vector<Key> keys;
      for (const auto& c : pairs.candidates()) {
        if (expected.count(key(c.pair))) keys.push_back(key(c.pair));
      }
      return keys;
    };
    EXPECT_EQ(in_reach(kept), in_reach(fresh));
    for (auto& p : x) {
      const Vec3 move = random.vector(0.03) + Vec3(100, 0, 0);
      p.x += static_cast<Real>(move[0]);
      p.y += static_cast<Real>(move[1]);
      p.z += static_cast<Real>(move[2]);
    }
    for (const auto& c : kept.candidates()) EXPECT_LE(kept.least_distance(c), c.distance);
  }
}

}  // namespace
