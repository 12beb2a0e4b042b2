#include "substep/rigid/shapes/triangle_mesh.h"

#include <algorithm>
#include <string>
#include <tuple>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/usize.h"

namespace substep::rigid {
namespace {

// Sines of the angles by which a direction may be off the normals around a corner or edge, and
// below which it is across an edge.
constexpr double kOff = 1e-5, kAcross = 1e-5;

}  // namespace

TriangleMesh::TriangleMesh(std::span<const Vec3> vertices,
                           std::span<const std::array<std::int32_t, 3>> faces)
    : vertices_(vertices.begin(), vertices.end()), faces_(faces.begin(), faces.end()) {
  if (faces.empty()) throw InputError("a mesh needs at least one triangle");
  const auto count = static_cast<std::int32_t>(vertices.size());
  for (std::int32_t k = 0; k < count; ++k) {
    if (!vertices[k].allFinite()) {
      throw InputError("vertex " + std::to_string(k) + " of the mesh is not finite");
    }
  }
  // Directed edges, and the number of each: 3 triangle + corner.
  std::vector<std::tuple<std::int32_t, std::int32_t, std::int64_t>> sides;
  std::vector<std::pair<std::int32_t, std::int32_t>> joined;
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const auto& v = faces[f];
    for (const std::int32_t k : v) {
      if (k < 0 || k >= count) {
        throw InputError("triangle " + std::to_string(f) + " of the mesh has corner " +
                         std::to_string(k) + ", there are " + std::to_string(count) + " vertices");
      }
    }
    const Vec3 e = vertices[v[1]] - vertices[v[0]], g = vertices[v[2]] - vertices[v[0]];
    const Vec3 n = e.cross(g);
    if (!(n.norm() > 1e-12 * std::max(e.squaredNorm(), g.squaredNorm()))) {
      throw InputError("triangle " + std::to_string(f) + " of the mesh has no area");
    }
    normals_.push_back(n.normalized());
    for (int k = 0; k < 3; ++k) {
      const std::int32_t a = v[k], b = v[(k + 1) % 3];
      sides.emplace_back(a, b, static_cast<std::int64_t>(3 * f) + k);
      joined.emplace_back(a, b);
      joined.emplace_back(b, a);
    }
  }
  std::sort(sides.begin(), sides.end());
  for (const auto& v : faces_) {
    std::array<std::int32_t, 3> third;
    for (int k = 0; k < 3; ++k) {
      const std::int32_t a = v[(k + 1) % 3], b = v[k];
      const auto found = std::lower_bound(sides.begin(), sides.end(), std::tuple(a, b, 0));
      const bool is_there =
          found != sides.end() && std::get<0>(*found) == a && std::get<1>(*found) == b;
      const std::int64_t side = is_there ? std::get<2>(*found) : 0;
      third[k] = is_there ? faces_[usize(side / 3)][(side + 2) % 3] : -1;
    }
    opposite_.push_back(third);
  }
  std::sort(joined.begin(), joined.end());
  joined.erase(std::unique(joined.begin(), joined.end()), joined.end());
  first_neighbour_.assign(vertices_.size() + 1, 0);
  for (const auto& [a, b] : joined) {
    ++first_neighbour_[a + 1];
    neighbours_.push_back(b);
  }
  for (std::size_t k = 0; k < vertices_.size(); ++k) first_neighbour_[k + 1] += first_neighbour_[k];

  std::vector<std::int32_t> all(faces_.size());
  for (std::size_t k = 0; k < all.size(); ++k) all[k] = static_cast<std::int32_t>(k);
  nodes_.reserve(2 * all.size());
  build(all);
}

// Halves at the median of the centres along the longest side.
void TriangleMesh::build(std::span<std::int32_t> triangles) {
  Vec3 low = vertices_[faces_[triangles[0]][0]], high = low;
  for (const std::int32_t t : triangles) {
    for (const std::int32_t v : faces_[t]) {
      low = low.cwiseMin(vertices_[v]), high = high.cwiseMax(vertices_[v]);
    }
  }
  const std::size_t node = nodes_.size();
  nodes_.push_back({low, high, triangles.size() == 1 ? triangles[0] : -1, 0});
  if (triangles.size() > 1) {
    int axis;
    (high - low).maxCoeff(&axis);
    const auto centre = [&](std::int32_t t) {
      const auto& f = faces_[t];
      return vertices_[f[0]][axis] + vertices_[f[1]][axis] + vertices_[f[2]][axis];
    };
    const std::size_t half = triangles.size() / 2;
    std::nth_element(triangles.begin(), triangles.begin() + static_cast<std::ptrdiff_t>(half),
                     triangles.end(), [&](std::int32_t s, std::int32_t t) {
                       return std::pair(centre(s), s) < std::pair(centre(t), t);
                     });
    build(triangles.first(half));
    build(triangles.subspan(half));
  }
  nodes_[node].next = static_cast<std::int32_t>(nodes_.size());
}

bool TriangleMesh::supports(int triangle, const Vec3& n) const {
  const auto& f = faces_[triangle];
  int far = 0;
  for (int k = 1; k < 3; ++k) {
    if (n.dot(vertices_[f[k]] - vertices_[f[far]]) > 0) far = k;
  }
  const Vec3& p = vertices_[f[far]];
  const auto beyond = [&](std::int32_t v) {
    const Vec3 d = vertices_[v] - p;
    return n.dot(d) > kOff * d.norm();
  };
  const auto along = [&](std::int32_t v) {  // n is across the edge to v
    const Vec3 d = vertices_[v] - p;
    return std::abs(n.dot(d)) <= kAcross * d.norm();
  };
  const int next = (far + 1) % 3, before = (far + 2) % 3;
  const bool along_next = along(f[next]), along_before = along(f[before]);
  if (along_next && along_before) return n.dot(normals_[triangle]) > 0;
  if (along_next || along_before) {
    const std::int32_t third = opposite_[triangle][along_next ? far : before];
    return third < 0 || !beyond(third);
  }
  for (std::int32_t k = first_neighbour_[f[far]]; k < first_neighbour_[f[far] + 1]; ++k) {
    if (beyond(neighbours_[k])) return false;
  }
  return true;
}

// The box of the mesh, turned.
Bounds TriangleMesh::bounds(const Pose& pose) const {
  const Vec3 centre = pose.to_world((low() + high()) / 2);
  const Vec3 half = pose.rotation.cwiseAbs() * ((high() - low()) / 2);
  return {centre - half, centre + half};
}

double TriangleMesh::outer_radius(const Pose& local) const {
  double most = 0;
  for (const Vec3& v : vertices_) most = std::max(most, local.to_world(v).norm());
  return most;
}

// The volumes of the tetrahedra that the direction spans with the edges, seen from the origin, have
// one sign within the triangle. Two triangles compute the same numbers for a common edge, up to the
// sign, so no ray slips between them (as in Woop, Benthin, Wald, "Watertight ray/triangle
// intersection", JCGT 2(1), 2013).
std::optional<RayHit> TriangleMesh::cast(int triangle, const Ray& ray) const {
  const Vec3& n = normals_[usize(triangle)];
  const double rate = n.dot(ray.direction);
  if (!(rate < 0)) return {};
  const auto& corner = faces_[usize(triangle)];
  const Vec3 a = vertices_[usize(corner[0])] - ray.origin;
  const Vec3 b = vertices_[usize(corner[1])] - ray.origin;
  const Vec3 c = vertices_[usize(corner[2])] - ray.origin;
  const Vec3& d = ray.direction;
  if (d.dot(a.cross(b)) > 0 || d.dot(b.cross(c)) > 0 || d.dot(c.cross(a)) > 0) return {};
  const double t = n.dot(a) / rate;
  if (!(t >= 0 && t <= ray.length)) return {};
  return RayHit{t, n};
}

// Piece by piece of the part within the box of the mesh, each about as long as a triangle of an
// even mesh, until one holds a hit.
std::optional<RayHit> TriangleMesh::cast(const Ray& ray) const {
  Passage box;
  for (int i = 0; i < 3; ++i) {
    box.cut(ray, Vec3::Unit(i), high()[i]);
    box.cut(ray, -Vec3::Unit(i), -low()[i]);
  }
  const double slack = 1e-9 * (high() - low()).norm();
  const double begin = std::max(box.enter - slack, 0.0);
  const double end = std::min(box.leave + slack, ray.length);
  if (!(begin <= end)) return {};
  const int pieces = static_cast<int>(std::ceil(std::sqrt(triangle_count())));
  std::optional<RayHit> nearest;
  for (int k = 0; k < pieces; ++k) {
    const double from = begin + (end - begin) * k / pieces;
    const double to = begin + (end - begin) * (k + 1) / pieces;
    const Vec3 p = ray.at(from), q = ray.at(to), room = Vec3::Constant(slack);
    for_each_in(p.cwiseMin(q) - room, p.cwiseMax(q) + room, [&](int triangle) {
      const auto hit = cast(triangle, ray);
      if (hit && (!nearest || hit->distance < nearest->distance)) nearest = hit;
    });
    if (nearest && nearest->distance <= to) break;
  }
  return nearest;
}

}  // namespace substep::rigid
