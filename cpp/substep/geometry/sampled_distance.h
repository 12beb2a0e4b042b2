// A signed distance sampled on a regular grid, made continuous by the quadratic B-spline whose
// coefficients are the samples d_i themselves:
//
//   f(x) = sum_i B((x - x_i) / h) d_i,   B a product of one-dimensional quadratic B-splines.
//
// Chosen over trilinear interpolation because f is continuously differentiable, as Newton's method
// wants, and over interpolating splines because the weights are positive and sum to 1:
//   - f never differs from a true distance (1-Lipschitz) by more than
//     sum_i B |x - x_i| <= sqrt(3 var B) h = sqrt(3)/2 h (error_bound());
//   - where d is smooth f = d + h^2/8 lap d + O(h^3): a sphere of radius R loses h^2/(4 R);
//   - grad f is a weighted mean of difference quotients, which bounds its length (lipschitz()).
// Outside the grid, with c the nearest point of the grid's box, f(x)^2 = |x - c|^2 + f(c)^2. As the
// box is convex and the surface inside of it, the true distance is at least that, and at most
// f(c) + |x - c|, sqrt(2) times as much.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "substep/core/usize.h"
#include "substep/geometry/shapes.h"

namespace substep::geometry {

class SampledDistance {
 public:
  // values[(i * n_y + j) * n_z + k] at origin + spacing (i, j, k); at least 4 nodes on each axis.
  // Throws InputError where the surface comes within two nodes of the border, and where neighbours
  // differ by more than twice the spacing, which no distance does.
  SampledDistance(std::array<std::int64_t, 3> shape, const Vec3& origin, double spacing,
                  std::vector<double> values, int threads = 0);

  SignedDistance signed_distance(const Vec3& x) const;
  Mat3 hessian(const Vec3& x) const;
  // Bound of |grad f| where f > 0, or for `inside` where f < 0.
  double lipschitz(bool inside) const { return inside ? lipschitz_inside_ : lipschitz_outside_; }
  double error_bound() const { return 0.8660254037844387 * spacing_; }

  const std::array<std::int64_t, 3>& shape() const { return shape_; }
  const Vec3& origin() const { return origin_; }
  double spacing() const { return spacing_; }
  const std::vector<double>& values() const { return values_; }

 private:
  struct Stencil;
  Stencil locate(const Vec3& x) const;
  double node(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return values_[usize((i * shape_[1] + j) * shape_[2] + k)];
  }
  void check_border() const;
  void bound_gradient(int threads);

  std::array<std::int64_t, 3> shape_;
  Vec3 origin_;
  double spacing_;
  std::vector<double> values_;
  double lipschitz_outside_ = 1, lipschitz_inside_ = 1;
};

}  // namespace substep::geometry
