// A tree of bounding boxes over the triangles of a surface: nearest points, and the generalized
// winding number, which tells inside from outside also where the surface is open, not manifold or
// cuts itself (Jacobson, Kavan, Sorkine-Hornung, "Robust inside-outside segmentation using
// generalized winding numbers", SIGGRAPH 2013):
//
//   w(x) = 1/(4 pi) sum_t Omega_t(x),   Omega_t the signed solid angle of triangle t seen from x.
//
// Far clusters of triangles are replaced by their Taylor expansion of second order (Barill,
// Dickson, Schmidt, Levin, Jacobson, "Fast winding numbers for soups and clouds", SIGGRAPH 2018,
// sec. 3.2).
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "substep/geometry/vectors.h"

namespace substep::geometry {

class TriangleTree {
 public:
  // vertices: 3 numbers each; faces: 3 indices each, in range.
  TriangleTree(const double* vertices, const std::int64_t* faces, std::int64_t face_count);

  struct Nearest {
    double distance = std::numeric_limits<double>::infinity();
    Vec3 point = Vec3::Zero();
    std::int64_t face = -1;
  };
  // The nearest point among those no further than `bound`; face -1: none.
  Nearest nearest(const Vec3& x, double bound = std::numeric_limits<double>::infinity()) const;

  // w(x), to about 0.04; 1 inside of a closed surface that looks outward, 0 outside.
  double winding_number(const Vec3& x) const;

  // Above 0 where w > 1/2, or w < -1/2 for a surface that looks inward as a whole.
  bool inside(const Vec3& x) const { return orientation_ * winding_number(x) > 0.5; }

  // Below 0 inside.
  double signed_distance(const Vec3& x) const {
    const double d = nearest(x).distance;
    return inside(x) ? -d : d;
  }

  // How many of the edges (pairs of vertices) pass through a face that has none of their ends. What
  // only touches, within 1e-9 of the size of the face, does not count. Same arrays as constructed.
  std::int64_t count_pierced(const double* vertices, const std::int64_t* faces,
                             const std::int64_t* edges, std::int64_t edge_count, int threads) const;

  // The directed edges cancel: w is then a whole number and changes at the surface only.
  bool closed() const { return closed_; }
  Vec3 lower() const { return nodes_.front().low; }
  Vec3 upper() const { return nodes_.front().high; }

 private:
  struct Triangle {
    Vec3 a, b, c;
    std::int64_t face;
  };
  struct Node {
    Vec3 low, high;
    std::int32_t first, count;  // of triangles; count 0: an inner node
    std::int32_t right;         // the left child follows its parent
  };
  // About `center`: first moment sum A n, second moment sum A n (c - center)^T, with area A, unit
  // normal n and centroid c of each triangle of the node; all lie within `radius`.
  struct Expansion {
    Vec3 center, dipole;
    Mat3 quadrupole;
    double radius;
  };
  static constexpr std::int32_t kLeaf = 4;  // triangles
  static constexpr double kFar = 2;  // beta of Barill et al.: clusters further than this many radii

  void build(std::int32_t first, std::int32_t last);
  Expansion expand(std::int32_t first, std::int32_t last) const;

  std::vector<Triangle> triangles_;  // in the order of the tree
  std::vector<Node> nodes_;
  std::vector<Expansion> expansions_;  // of the nodes
  double orientation_ = 1;
  bool closed_ = false;
};

}  // namespace substep::geometry
