// GJK and EPA on polytopes against all pairs of features.
#include <gtest/gtest.h>

#include <set>

#include "rigid_narrow_shapes.h"
#include "substep/geometry/closest_points.h"
#include "substep/rigid/convex_contacts.h"

namespace substep::rigid {
namespace {

struct World {
  std::vector<Vec3> vertices, normals;
  std::vector<std::pair<Vec3, Vec3>> edges;
  std::vector<std::array<Vec3, 3>> triangles;
};

World place(const ConvexHull& hull, const Pose& pose) {
  World world;
  for (const Vec3& v : hull.vertices()) world.vertices.push_back(pose.to_world(v));
  for (int f = 0; f < hull.face_count(); ++f) {
    world.normals.push_back(pose.rotation * hull.plane(f).normal);
    const auto loop = hull.corners(f);
    for (std::size_t k = 0; k < loop.size(); ++k) {
      const std::size_t next = (k + 1) % loop.size();
      const Vec3 &a = world.vertices[loop[k]], &b = world.vertices[loop[next]];
      if (loop[k] < loop[next]) world.edges.emplace_back(a, b);
      if (k > 0 && next > 0) world.triangles.push_back({world.vertices[loop[0]], a, b});
    }
  }
  return world;
}

double gap(const World& a, const World& b, const Vec3& n) {
  double low = 1e300, high = -1e300;
  for (const Vec3& x : a.vertices) high = std::max(high, n.dot(x));
  for (const Vec3& y : b.vertices) low = std::min(low, n.dot(y));
  return low - high;
}

// Overlap: the least depth is along the normal of a face or across two edges. Apart: the distance
// is that of a corner and a triangle or of two edges.
double exact_separation(const World& a, const World& b) {
  double most = -1e300;
  for (const Vec3& n : a.normals) most = std::max(most, gap(a, b, n));
  for (const Vec3& n : b.normals) most = std::max(most, gap(a, b, -n));
  for (const auto& [p, q] : a.edges) {
    for (const auto& [r, s] : b.edges) {
      const Vec3 n = (q - p).cross(s - r);
      if (n.norm() < 1e-9) continue;
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
  const auto to_faces = [&](const World& points, const World& faces) {
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
        const double want = exact_separation(place(*first, pose_a), place(*second, pose_b));
        ASSERT_NEAR(axis.separation, want, 1e-9)
            << first->vertex_count() << ' ' << second->vertex_count() << ' ' << k << ' ' << far;
        const Vec3 n = pose_a.rotation * axis.normal;
        ASSERT_NEAR(separation(first, pose_a, second, pose_b, n), want, 1e-9);
      }
    }
  }
}

}  // namespace
}  // namespace substep::rigid
