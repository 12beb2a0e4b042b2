#include "substep/rigid/shapes/convex_hull.h"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/rigid/shapes/mass_properties.h"

namespace substep::rigid {
namespace {

constexpr double kInside = 1e-9, kFlat = 1e-7, kThin = 1e-6;  // of the extent

struct Triangle {
  std::int32_t v[3], across[3];  // across[k]: the neighbour over the edge v[k], v[k + 1]
  Vec3 normal;                   // of length 1
  double offset, area;
  std::vector<std::int32_t> outside;
  bool alive = true;
};

class Quickhull {
 public:
  Quickhull(std::span<const Vec3> points, double extent) : points_(points), extent_(extent) {
    start();
    // Faces are appended, so a sweep over the list meets all of them.
    for (std::size_t f = 0; f < triangles_.size(); ++f) {
      if (triangles_[f].alive && !triangles_[f].outside.empty()) {
        add_point(static_cast<std::int32_t>(f));
      }
    }
  }
  std::vector<Triangle>& triangles() { return triangles_; }

 private:
  double height(const Triangle& t, std::int32_t p) const {
    return t.normal.dot(points_[p]) - t.offset;
  }

  Triangle make(std::int32_t a, std::int32_t b, std::int32_t c) const {
    Triangle t;
    t.v[0] = a, t.v[1] = b, t.v[2] = c;
    const Vec3 n = (points_[b] - points_[a]).cross(points_[c] - points_[a]);
    t.area = n.norm();
    t.normal = t.area > 0 ? Vec3(n / t.area) : Vec3::Zero();
    t.offset = t.normal.dot((points_[a] + points_[b] + points_[c]) / 3);
    return t;
  }

  // The largest of f over the points.
  template <class F>
  std::int32_t farthest(F&& f) const {
    std::int32_t best = 0;
    for (std::int32_t k = 1; k < static_cast<std::int32_t>(points_.size()); ++k) {
      if (f(k) > f(best)) best = k;
    }
    return best;
  }

  // A tetrahedron: the points farthest apart along an axis, from their line, from that plane.
  void start() {
    std::int32_t a = 0, b = 0;
    for (int i = 0; i < 3; ++i) {
      const std::int32_t low = farthest([&](std::int32_t k) { return -points_[k][i]; });
      const std::int32_t high = farthest([&](std::int32_t k) { return points_[k][i]; });
      if (points_[high][i] - points_[low][i] > (points_[b] - points_[a]).cwiseAbs().maxCoeff()) {
        a = low, b = high;
      }
    }
    const Vec3 line = (points_[b] - points_[a]).normalized();
    const auto from_line = [&](std::int32_t k) {
      return (points_[k] - points_[a]).cross(line).norm();
    };
    std::int32_t c = farthest(from_line);
    Triangle base = make(a, b, c);
    std::int32_t d = farthest([&](std::int32_t k) { return std::abs(height(base, k)); });
    if (!(from_line(c) > kThin * extent_) || !(std::abs(height(base, d)) > kThin * extent_)) {
      throw InputError("the points of a convex hull must span a volume; these lie in a plane");
    }
    if (height(base, d) > 0) std::swap(b, c);  // d is below a b c
    const std::int32_t faces[4][3] = {{a, b, c}, {a, d, b}, {b, d, c}, {c, d, a}};
    const std::int32_t across[4][3] = {{1, 2, 3}, {3, 2, 0}, {1, 3, 0}, {2, 1, 0}};
    for (int f = 0; f < 4; ++f) {
      triangles_.push_back(make(faces[f][0], faces[f][1], faces[f][2]));
      std::copy(across[f], across[f] + 3, triangles_.back().across);
    }
    std::vector<std::int32_t> all(points_.size());
    for (std::size_t k = 0; k < all.size(); ++k) all[k] = static_cast<std::int32_t>(k);
    assign(all, 0);
  }

  // Each point goes to the first face from `first` on that it is outside of.
  void assign(const std::vector<std::int32_t>& points, std::size_t first) {
    for (const std::int32_t p : points) {
      for (std::size_t f = first; f < triangles_.size(); ++f) {
        if (height(triangles_[f], p) > kInside * extent_) {
          triangles_[f].outside.push_back(p);
          break;
        }
      }
    }
  }

  // Replaces what the farthest point outside of a face sees by a fan over its horizon.
  void add_point(std::int32_t face) {
    std::int32_t apex = triangles_[face].outside[0];
    for (const std::int32_t p : triangles_[face].outside) {
      if (height(triangles_[face], p) > height(triangles_[face], apex)) apex = p;
    }
    // Depth first, with edges in order, so that the horizon is a loop in order.
    std::vector<std::pair<std::int32_t, int>> horizon;
    std::vector<std::int32_t> seen, orphans;
    see(face, 0, apex, seen, horizon, 3);
    const auto first = static_cast<std::int32_t>(triangles_.size());
    const auto n = static_cast<std::int32_t>(horizon.size());
    for (std::int32_t k = 0; k < n; ++k) {
      const auto [beyond, edge] = horizon[k];
      // The edge as the cut face saw it, which is against the sense of the one beyond.
      const std::int32_t u = triangles_[beyond].v[(edge + 1) % 3], v = triangles_[beyond].v[edge];
      Triangle t = make(u, v, apex);
      t.across[0] = beyond;
      t.across[1] = first + (k + 1) % n;
      t.across[2] = first + (k + n - 1) % n;
      triangles_[beyond].across[edge] = first + k;
      triangles_.push_back(std::move(t));
    }
    for (const std::int32_t f : seen) {
      for (const std::int32_t p : triangles_[f].outside) {
        if (p != apex) orphans.push_back(p);
      }
      triangles_[f].outside = {};
    }
    assign(orphans, first);
  }

  // Marks the faces that the point sees, from `face` on, entered by edge `from`.
  void see(std::int32_t face, int from, std::int32_t point, std::vector<std::int32_t>& seen,
           std::vector<std::pair<std::int32_t, int>>& horizon, int edges) {
    triangles_[face].alive = false;
    seen.push_back(face);
    for (int step = 3 - edges; step < 3; ++step) {
      const int k = (from + step) % 3;
      const std::int32_t next = triangles_[face].across[k];
      if (!triangles_[next].alive) continue;
      int back = 0;
      while (triangles_[next].across[back] != face ||
             triangles_[next].v[back] != triangles_[face].v[(k + 1) % 3]) {
        ++back;
      }
      if (height(triangles_[next], point) > 0) {
        see(next, back, point, seen, horizon, 2);
      } else {
        horizon.emplace_back(next, back);
      }
    }
  }

  std::span<const Vec3> points_;
  double extent_;
  std::vector<Triangle> triangles_;
};

// Groups of triangles in one plane: from the largest on, neighbours whose corners are in its plane.
std::vector<std::int32_t> planar_groups(const std::vector<Triangle>& triangles,
                                        std::span<const Vec3> points, double tolerance) {
  std::vector<std::int32_t> order, group(triangles.size(), -1), stack;
  for (std::size_t f = 0; f < triangles.size(); ++f) {
    if (triangles[f].alive) order.push_back(static_cast<std::int32_t>(f));
  }
  std::stable_sort(order.begin(), order.end(), [&](std::int32_t f, std::int32_t g) {
    return triangles[f].area > triangles[g].area;
  });
  for (const std::int32_t seed : order) {
    if (group[seed] >= 0) continue;
    const Triangle& plane = triangles[seed];
    const auto flat = [&](const Triangle& t) {
      for (const std::int32_t v : t.v) {
        if (std::abs(plane.normal.dot(points[v]) - plane.offset) > tolerance) return false;
      }
      return t.normal.dot(plane.normal) > 0 || t.area == 0;
    };
    group[seed] = seed;
    stack.assign(1, seed);
    while (!stack.empty()) {
      const Triangle& t = triangles[stack.back()];
      stack.pop_back();
      for (const std::int32_t next : t.across) {
        if (group[next] < 0 && flat(triangles[next])) group[next] = seed, stack.push_back(next);
      }
    }
  }
  return group;
}

struct Faces {
  std::vector<Vec3> vertices;
  std::vector<FacePlane> planes;
  std::vector<std::int32_t> first_corner, corners;
};

// The groups as polygons; false where the border of one is no single loop.
bool make_faces(const std::vector<Triangle>& triangles, std::span<const Vec3> points,
                double tolerance, Faces& out) {
  const std::vector<std::int32_t> group = planar_groups(triangles, points, tolerance);
  // The border of each group, as successors of its corners; corners of three groups or more stay.
  std::map<std::int32_t, std::map<std::int32_t, std::int32_t>> borders;
  std::vector<std::int32_t> meeting(points.size(), 0), renumbered(points.size(), -1);
  for (std::size_t f = 0; f < triangles.size(); ++f) {
    if (!triangles[f].alive) continue;
    for (int k = 0; k < 3; ++k) {
      if (group[triangles[f].across[k]] == group[f]) continue;
      const std::int32_t v = triangles[f].v[k];
      if (!borders[group[f]].emplace(v, triangles[f].v[(k + 1) % 3]).second) return false;
      ++meeting[v];
    }
  }
  out = {};
  out.first_corner.push_back(0);
  for (const auto& [seed, next] : borders) {
    const std::int32_t start = next.begin()->first;
    std::int32_t v = start;
    std::size_t walked = 0;
    Vec3 normal = Vec3::Zero();  // Newell's: the sum of cross products of consecutive corners
    do {
      const std::int32_t w = next.at(v);
      normal += (points[v] - points[start]).cross(points[w] - points[start]);
      if (meeting[v] >= 3) {
        if (renumbered[v] < 0) {
          renumbered[v] = static_cast<std::int32_t>(out.vertices.size());
          out.vertices.push_back(points[v]);
        }
        out.corners.push_back(renumbered[v]);
      }
      v = w;
      ++walked;
    } while (v != start && walked <= next.size());
    const auto first = usize(out.first_corner.back());
    if (walked != next.size() || out.corners.size() < first + 3 || !(normal.norm() > 0)) {
      return false;
    }
    normal.normalize();
    double offset = normal.dot(points[start]);
    for (std::size_t k = first; k < out.corners.size(); ++k) {
      offset = std::max(offset, normal.dot(out.vertices[out.corners[k]]));
    }
    out.planes.push_back({normal, offset});
    out.first_corner.push_back(static_cast<std::int32_t>(out.corners.size()));
  }
  return true;
}

}  // namespace

ConvexHull::ConvexHull(std::span<const Vec3> points) {
  if (points.size() < 4) throw InputError("a convex hull needs at least four points");
  Vec3 low = points[0], high = points[0];
  for (const Vec3& p : points) {
    if (!p.allFinite()) throw InputError("the points of a convex hull must be finite");
    low = low.cwiseMin(p), high = high.cwiseMax(p);
  }
  const double extent = (high - low).maxCoeff();
  if (!(extent > 0)) throw InputError("the points of a convex hull must span a volume");
  Quickhull hull(points, extent);
  Faces faces;
  if (!make_faces(hull.triangles(), points, kFlat * extent, faces) &&
      !make_faces(hull.triangles(), points, -1, faces)) {
    throw InputError("the points of a convex hull are too close to each other or to a plane");
  }
  vertices_ = std::move(faces.vertices);
  planes_ = std::move(faces.planes);
  first_corner_ = std::move(faces.first_corner);
  corners_ = std::move(faces.corners);
  thickness_ = 0.5 * (high - low).minCoeff();
  for (const Vec3& v : vertices_) {
    centre_ += v / static_cast<double>(vertices_.size());
    radius_ = std::max(radius_, v.norm());
  }
}

Bounds ConvexHull::bounds(const Pose& pose) const {
  Vec3 low = pose.to_world(vertices_[0]), high = low;
  for (const Vec3& v : vertices_) {
    const Vec3 x = pose.to_world(v);
    low = low.cwiseMin(x), high = high.cwiseMax(x);
  }
  return {low, high};
}

Ball ConvexHull::inner_ball() const {
  Ball ball{centre_, std::numeric_limits<double>::infinity()};
  for (const FacePlane& plane : planes_) {
    ball.radius = std::min(ball.radius, plane.offset - plane.normal.dot(ball.centre));
  }
  return ball;
}

double ConvexHull::outer_radius(const Pose& local) const {
  double most = 0;
  for (const Vec3& v : vertices_) most = std::max(most, local.to_world(v).norm());
  return most;
}

MassMoments ConvexHull::moments(double density) const {
  SolidIntegrals solid(vertices_[0]);
  for (int f = 0; f < face_count(); ++f) {
    const auto corner = [&](std::size_t k) { return vertices_[usize(corners(f)[k])]; };
    for (std::size_t k = 2; k < corners(f).size(); ++k)
      solid.add(corner(0), corner(k - 1), corner(k));
  }
  return solid.moments(density);
}

std::optional<RayHit> ConvexHull::cast(const Ray& ray) const {
  Passage passage;
  for (const FacePlane& plane : planes_) passage.cut(ray, plane.normal, plane.offset);
  return passage.hit(ray.length);
}

}  // namespace substep::rigid
