// Ground made of triangles. Only its outside counts, from which the corners of a triangle are seen
// counter-clockwise: a shape whose centre is behind a triangle does not touch it. Triangles that
// share corners (by index) are one surface, whose inner edges nothing can catch on.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/rigid/shapes/shape.h"

namespace substep::rigid {

class TriangleMesh {
 public:
  // InputError: a corner is not finite, an index is out of range, a triangle has no area.
  TriangleMesh(std::span<const Vec3> vertices, std::span<const std::array<std::int32_t, 3>> faces);

  int triangle_count() const { return static_cast<int>(faces_.size()); }
  const std::array<std::int32_t, 3>& face(int triangle) const { return faces_[triangle]; }
  const std::vector<Vec3>& vertices() const { return vertices_; }
  const Vec3& normal(int triangle) const { return normals_[triangle]; }
  Vec3 low() const { return nodes_[0].low; }
  Vec3 high() const { return nodes_[0].high; }

  // Calls visit(triangle) for those whose bounds meet the box, in an order of the mesh's own.
  template <class Visit>
  void for_each_in(const Vec3& box_low, const Vec3& box_high, Visit&& visit) const {
    for (std::int32_t k = 0; k < static_cast<std::int32_t>(nodes_.size());) {
      const Node& node = nodes_[k];
      const bool apart = (node.low.array() > box_high.array()).any() ||
                         (node.high.array() < box_low.array()).any();
      if (!apart && node.triangle >= 0) visit(static_cast<int>(node.triangle));
      k = apart ? node.next : k + 1;
    }
  }

  // Whether n may be the normal of a contact at a corner or edge of the triangle that is farthest
  // along it: no corner that an edge joins to there is farther, so that n is between the normals of
  // the triangles around. Always so for the triangle's own normal.
  bool supports(int triangle, const Vec3& n) const;

  // As shape.h says; it bounds no solid.
  Bounds bounds(const Pose& pose) const;
  double outer_radius(const Pose& local) const;
  std::optional<RayHit> cast(const Ray& ray) const;

 private:
  // In the order of a walk down the tree; `next` follows its subtree.
  struct Node {
    Vec3 low, high;
    std::int32_t triangle, next;  // triangle -1: an inner node
  };
  void build(std::span<std::int32_t> triangles);
  std::optional<RayHit> cast(int triangle, const Ray& ray) const;

  std::vector<Vec3> vertices_;
  std::vector<std::array<std::int32_t, 3>> faces_;
  std::vector<Vec3> normals_;
  std::vector<std::array<std::int32_t, 3>> opposite_;  // corner across the edge k, k + 1, or -1
  std::vector<std::int32_t> first_neighbour_, neighbours_;  // of each vertex
  std::vector<Node> nodes_;
};

}  // namespace substep::rigid
