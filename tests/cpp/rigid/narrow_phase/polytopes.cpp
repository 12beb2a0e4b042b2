// GJK and EPA on polytopes against all pairs of features.
#include <gtest/gtest.h>

#include <set>

#include "shapes.h"
#include "substep/core/usize.h"
#include "substep/geometry/closest_points.h"
#include "substep/rigid/collision/convex_contacts.h"

namespace substep::rigid {
namespace {

struct Placed {
  std::vector<Vec3> vertices, normals;
  std::vector<std::pair<Vec3, Vec3>> edges;
  std::vector<std::array<Vec3, 3>> triangles;
};

Placed place(const Polytope& polytope, const Pose& pose) {
  Placed world;
  for (const Vec3& v : polytope.vertices) world.vertices.push_back(pose.to_world(v));
  for (std::size_t f = 0; f < polytope.planes.size(); ++f) {
    world.normals.push_back(pose.rotation * polytope.planes[f].normal);
    const auto first = usize(polytope.first_corner[f]);
    const auto end = usize(polytope.first_corner[f + 1]);
    const auto loop = polytope.corners.subspan(first, end - first);
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const std::size_t next = (k + 1) % loop.size();
      const Vec3 &a = world.vertices[loop[k]], &b = world.vertices[loop[next]];
      if (loop[k] < loop[next]) world.edges.emplace_back(a, b);
      if (k > 0 && next > 0) world.triangles.push_back({world.vertices[loop[0]], a, b});
    }
  }
  return world;
}

double gap(const Placed& a, const Placed& b, const Vec3& n) {
  double low = 1e300, high = -1e300;
  for (const Vec3& x : a.vertices) high = std::max(high, n.dot(x));
  for (const Vec3& y : b.vertices) low = std::min(low, n.dot(y));
  return low - high;
}

// Overlap: the least depth is along the normal of a face or across two edges. Apart: the distance
// is that of a corner and a triangle or of two edges.
double exact_separation(const Placed& a, const Placed& b) {
  double most = -1e300;
  for (const Vec3& n : a.normals) most = std::max(most, gap(a, b, n));
  for (const Vec3& n : b.normals) most = std::max(most, gap(a, b, -n));
  for (const auto& [p, q] : a.edges) {
    for (const auto& [r, s] : b.edges) {
      const Vec3 n = (q - p).normalized().cross((s - r).normalized());
      if (n.norm() < 1e-7) continue;
      most = std::max({most, gap(a, b, n.normalized()), gap(a, b, -n.normalized())});
    }
  }
  if (most <= 0) return most;
  double least = 1e300;
  for (const auto& [p, q] : a.edges) {
    for (const auto& [r, s] : b.edges) {
      const auto [u, v] = geometry::closest_on_segments(p, q, r, s);
      least = std::min(least, (p + u * (q - p) - r - v * (s - r)).norm());
    }
  }
  const auto to_faces = [&](const Placed& points, const Placed& faces) {
    for (const Vec3& x : points.vertices) {
      for (const auto& t : faces.triangles) {
        const auto w = geometry::closest_on_triangle(x, t[0], t[1], t[2]);
        least = std::min(least, (x - w[0] * t[0] - w[1] * t[1] - w[2] * t[2]).norm());
      }
    }
  };
  to_faces(a, b);
  to_faces(b, a);
  return least;
}

TEST(NarrowPolytopes, AxisIsTheBestOfAllFeatures) {
  Random random(12);
  std::vector<std::shared_ptr<const ConvexHull>> hulls;
  for (const int n : {4, 6, 12, 30}) hulls.push_back(random_hull(random, n));
  std::vector<Vec3> cube;
  for (int k = 0; k < 8; ++k) {
    cube.emplace_back(k & 1 ? 0.4 : -0.4, k & 2 ? 0.3 : -0.3, k & 4 ? 0.5 : -0.5);
  }
  hulls.push_back(std::make_shared<const ConvexHull>(cube));
  for (const auto& first : hulls) {
    for (const auto& second : hulls) {
      for (int k = 0; k < 30; ++k) {
        Pose pose_a(direction(random), rotation(random));
        const double far = std::pow(10.0, uniform(random, -9, -0.5)) * (k % 2 ? 1 : -1);
        Pose pose_b = placed_at_distance(first, pose_a, second, far, random);
        if (k % 5 == 0) {  // turned alike: faces and edges are parallel
          pose_b = Pose(pose_a.position, pose_a.rotation);
          const Vec3 d = k % 10 ? direction(random) : Vec3(pose_a.rotation.col(k / 10));
          pose_b.position += (far - separation(first, pose_a, second, pose_b, d)) * d;
        }
        const Convex a = convex(*first), b = convex(*second);
        const Axis axis = best_axis({a, b, pose_b.relative_to(pose_a)}, 1e9);
        const double want = exact_separation(place(a.polytope, pose_a), place(b.polytope, pose_b));
        ASSERT_NEAR(axis.separation, want, 1e-9)
            << first->vertex_count() << ' ' << second->vertex_count() << ' ' << k << ' ' << far;
        const Vec3 n = pose_a.rotation * axis.normal;
        ASSERT_NEAR(separation(first, pose_a, second, pose_b, n), want, 1e-9);
      }
    }
  }
}

// Plates of 1 : 1000, sizes 1 : 10^4, a million metres out, and boxes turned alike to 1e-9:
// touching, apart and overlapping by 1e-9 of the size and more.
TEST(NarrowPolytopes, ThinUnequalAndFarOut) {
  Random random(21);
  const auto half = [&] { return uniform(random, 0.1, 1); };
  for (int k = 0; k < 4000; ++k) {
    Vec3 h(half(), half(), half()), g(half(), half(), half());
    const int kind = k % 4;
    if (kind == 0) h[k / 4 % 3] *= 1e-3, g[k / 12 % 3] *= k % 8 ? 1e-3 : 1;
    if (kind == 1) g *= std::pow(10.0, uniform(random, -4, 4));
    const Box box_a{h}, box_b{g};
    const double size = std::min(h.minCoeff(), g.minCoeff());
    const double large = std::max(h.maxCoeff(), g.maxCoeff());
    const double gap = size * std::pow(10.0, uniform(random, -9, -0.3)) * (k % 3 ? 1 : -1);
    const Pose pose_a((kind == 2 ? 1e6 : 1) * direction(random), rotation(random));
    Pose pose_b = placed_at_distance(box_a, pose_a, box_b, gap, random);
    if (kind == 3) {
      const Mat3 small = Eigen::AngleAxisd(k % 8 == 3 ? 0 : 1e-9, direction(random)).matrix();
      pose_b = Pose(pose_a.position, Mat3(pose_a.rotation * small));
      const Vec3 d = k % 5 ? direction(random) : Vec3(pose_a.rotation.col(k % 3));
      pose_b.position += (gap - separation(box_a, pose_a, box_b, pose_b, d)) * d;
    }
    const BoxPolytope arrays_a(h), arrays_b(g);
    const Convex a = convex(box_a, arrays_a), b = convex(box_b, arrays_b);
    const Pose relative = pose_b.relative_to(pose_a);
    const double want = exact_separation(place(a.polytope, Pose()), place(b.polytope, relative));
    const Axis axis = best_axis({a, b, relative}, 1e9);
    ASSERT_NEAR(axis.separation, want, (kind == 3 ? 3e-9 : 1e-14) * large) << k;
    ASSERT_NEAR(axis.normal.norm(), 1, 1e-12);
    // The manifold: its face may be worse by 1/50 of the size.
    Manifold manifold;
    Cache cache;
    const double margin = 0.5 * size, tolerance = 0.05 * size + (kind == 2 ? 1e-9 : 1e-12 * large);
    const bool touch = collide(box_a, pose_a, box_b, pose_b, margin, manifold, cache);
    ASSERT_TRUE(touch == (want <= margin) || std::abs(want - margin) < tolerance) << k;
    if (touch) {
      ASSERT_NEAR(deepest(manifold), want, tolerance) << k;
    }
  }
}

}  // namespace
}  // namespace substep::rigid
