// Ground: the solid below a surface z = H(x, y) over a rectangle, with upright sides at its border
// and without a bottom. H is the bicubic B-spline whose coefficients are the heights h_ij:
//
//   H(x, y) = sum_ij B((x - x_i) / s) B((y - y_j) / s) h_ij,
//
// one row of them continued beyond each border in a straight line. Chosen over the triangles
// between the heights because H is twice continuously differentiable, as Newton's method wants
// (in a valley the distance to triangles has a kink right at the surface), and over interpolating
// splines because the weights are positive and sum to 1: H stays between the heights around it. A
// plane is itself; where the heights are smooth H = h + s^2/6 lap h + O(s^4).
//
// The distance is the exact one to that surface: Newton's method starts at the triangles between
// its nodes, in all cells that may be nearest by a pyramid of lowest and highest heights.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/shapes.h"

namespace substep::geometry {

class HeightField {
 public:
  // heights[i * n_y + j] above origin + spacing (i, j, 0); at least 2 nodes on each axis. Throws
  // InputError where one is not finite, or neighbours differ by more than kSteepest spacings.
  HeightField(std::array<std::int64_t, 2> shape, const Vec3& origin, double spacing,
              std::vector<double> heights);
  static constexpr double kSteepest = 1000;

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  double lipschitz(bool) const { return 1; }

  const std::array<std::int64_t, 2>& shape() const { return shape_; }
  const Vec3& origin() const { return origin_; }
  double spacing() const { return spacing_; }
  const std::vector<double>& heights() const { return heights_; }

 private:
  using Vec2 = Eigen::Vector2d;
  using Mat2 = Eigen::Matrix2d;
  // H and its derivatives at a place of the rectangle.
  struct Patch {
    double height;
    Vec2 slope;
    Mat2 bend;
  };
  // The point of the surface that is nearest to another one, over `at`.
  struct Foot {
    Vec2 at;
    Patch patch;
    bool fixed[2];  // held by the border along this axis
  };
  struct Range {
    double low, high;
  };
  // Blocks of cells, 2^level along each side.
  struct Level {
    std::int64_t nx, ny;
    std::vector<Range> ranges;
  };
  struct Start {
    double distance2;
    Vec2 at;
  };
  enum class Part { kSurface, kEdge, kSide };
  struct Nearest {
    SignedDistance distance;
    Part part;
    Foot foot;
  };

  void check() const;
  void build_levels();
  double ghost(std::int64_t i, std::int64_t j) const;
  double node(std::int64_t i, std::int64_t j) const { return nodes_[usize(i * shape_[1] + j)]; }
  std::int64_t cell(const Vec2& at, int axis) const;
  Patch patch(const Vec2& at) const;
  Vec2 clamped(const Vec2& at) const { return at.cwiseMax(0.0).cwiseMin(lengths_); }
  double distance2(std::size_t level, std::int64_t i, std::int64_t j, const Vec3& x) const;
  void search(std::size_t level, std::int64_t i, std::int64_t j, const Vec3& x, Start& best) const;
  Foot foot(const Vec3& x) const;
  Nearest nearest(const Vec3& x) const;

  std::array<std::int64_t, 2> shape_;
  Vec3 origin_;
  double spacing_;
  Vec2 lengths_;                 // of the rectangle
  std::vector<double> heights_;  // the coefficients
  std::vector<double> nodes_;    // H at the nodes
  std::vector<Level> levels_;    // of the cells, of blocks of 2 x 2 of them, ...
};

}  // namespace substep::geometry
