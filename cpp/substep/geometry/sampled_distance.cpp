#include "substep/geometry/sampled_distance.h"

#include <algorithm>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::geometry {

// The 27 nodes about x and the weights of their values along each axis: B, B' and B''.
struct SampledDistance::Stencil {
  std::array<std::int64_t, 3> first;
  double weight[3][3], slope[3][3], bend[3][3];
  Vec3 beyond;      // x - c
  bool outside[3];  // x was moved to c along this axis
};

namespace {

std::string index_text(std::int64_t i, std::int64_t j, std::int64_t k) {
  return "[" + std::to_string(i) + ", " + std::to_string(j) + ", " + std::to_string(k) + "]";
}

}  // namespace

SampledDistance::SampledDistance(std::array<std::int64_t, 3> shape, const Vec3& origin,
                                 double spacing, std::vector<double> values, int threads)
    : shape_(shape), origin_(origin), spacing_(spacing), values_(std::move(values)) {
  if (!(spacing > 0) || !std::isfinite(spacing))
    throw InputError("spacing: expected a number above 0, got " + std::to_string(spacing));
  for (int axis = 0; axis < 3; ++axis) {
    if (shape[usize(axis)] < 4)
      throw InputError("values: expected at least 4 nodes along axis " + std::to_string(axis));
  }
  if (values_.size() != usize(shape[0] * shape[1] * shape[2]))
    throw InputError("values: their number is not that of the grid's nodes");
  check_border();
  bound_gradient(threads);
}

void SampledDistance::check_border() const {
  const auto near_border = [&](std::int64_t i, int axis) {
    return i < 2 || i >= shape_[usize(axis)] - 2;
  };
  for (std::int64_t i = 0; i < shape_[0]; ++i) {
    for (std::int64_t j = 0; j < shape_[1]; ++j) {
      for (std::int64_t k = 0; k < shape_[2]; ++k) {
        const double value = node(i, j, k);
        if (!std::isfinite(value))
          throw InputError("values" + index_text(i, j, k) + ": expected a finite number");
        if (value <= 0 && (near_border(i, 0) || near_border(j, 1) || near_border(k, 2)))
          throw InputError(
              "values" + index_text(i, j, k) +
              ": the surface comes within two nodes of the grid's border; pad the grid");
      }
    }
  }
}

// The quadratic B-spline is the linear one convolved with a box, so |grad f| nowhere exceeds the
// largest |grad g| of the trilinear interpolation g within half a cell. In a cell |grad g|^2 is
// convex along each axis, so largest in a corner, where it is the sum of the squared differences
// to the three neighbours. Where f > 0 a node among the 27 about the point is above 0, and the
// others differ from it by six steps at most.
void SampledDistance::bound_gradient(int threads) {
  struct Largest {
    double outside = 1, inside = 1;
  };
  std::vector<Largest> largest(usize(shape_[0]));
  const double near = 12 * spacing_;
  const auto [nx, ny, nz] = shape_;
  const auto plane = [&](std::int64_t i) {
    auto& [outside, inside] = largest[usize(i)];
    for (std::int64_t j = 0; j < ny; ++j) {
      for (std::int64_t k = 0; k < nz; ++k) {
        const double here = node(i, j, k);
        const auto step2 = [&](bool there, std::int64_t a, std::int64_t b, std::int64_t c) {
          if (!there) return 0.0;
          const double slope = (node(a, b, c) - here) / spacing_;
          if (std::abs(slope) > 2)
            throw InputError("values" + index_text(i, j, k) +
                             ": a neighbour differs by more than twice the spacing; this is no "
                             "distance");
          return slope * slope;
        };
        const double bound = std::max(step2(i > 0, i - 1, j, k), step2(i + 1 < nx, i + 1, j, k)) +
                             std::max(step2(j > 0, i, j - 1, k), step2(j + 1 < ny, i, j + 1, k)) +
                             std::max(step2(k > 0, i, j, k - 1), step2(k + 1 < nz, i, j, k + 1));
        if (here > -near) outside = std::max(outside, bound);
        if (here < near) inside = std::max(inside, bound);
      }
    }
  };
  parallel_chunks(nx, plane, threads);
  Largest all;
  for (const Largest& part : largest) {
    all.outside = std::max(all.outside, part.outside);
    all.inside = std::max(all.inside, part.inside);
  }
  lipschitz_outside_ = std::sqrt(all.outside);
  lipschitz_inside_ = std::sqrt(all.inside);
}

auto SampledDistance::locate(const Vec3& x) const -> Stencil {
  Stencil stencil;
  for (int d = 0; d < 3; ++d) {
    const double q = (x[d] - origin_[d]) / spacing_;
    const double top = static_cast<double>(shape_[usize(d)]) - 1.5;
    const double inside = q >= 0.5 ? std::min(q, top) : 0.5;  // also where q is NaN
    const double center = std::min(std::floor(inside + 0.5), top - 0.5);
    const double s = inside - center;
    stencil.outside[d] = inside != q;
    stencil.beyond[d] = stencil.outside[d] ? (q - inside) * spacing_ : 0.0;
    stencil.first[usize(d)] = static_cast<std::int64_t>(center) - 1;
    const double weight[3] = {0.5 * (0.5 - s) * (0.5 - s), 0.75 - s * s,
                              0.5 * (0.5 + s) * (0.5 + s)};
    const double slope[3] = {s - 0.5, -2 * s, s + 0.5};
    const double bend[3] = {1, -2, 1};
    for (int i = 0; i < 3; ++i) {
      stencil.weight[d][i] = weight[i];
      stencil.slope[d][i] = slope[i] / spacing_;
      stencil.bend[d][i] = bend[i] / (spacing_ * spacing_);
    }
  }
  return stencil;
}

SignedDistance SampledDistance::signed_distance(const Vec3& x) const {
  const Stencil s = locate(x);
  double f = 0;
  Vec3 gradient = Vec3::Zero();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      double value = 0, along = 0;
      for (int k = 0; k < 3; ++k) {
        const double d = node(s.first[0] + i, s.first[1] + j, s.first[2] + k);
        value += s.weight[2][k] * d;
        along += s.slope[2][k] * d;
      }
      f += s.weight[0][i] * s.weight[1][j] * value;
      gradient +=
          Vec3(s.slope[0][i] * s.weight[1][j] * value, s.weight[0][i] * s.slope[1][j] * value,
               s.weight[0][i] * s.weight[1][j] * along);
    }
  }
  if (!(s.outside[0] || s.outside[1] || s.outside[2])) return {f, gradient};
  for (int d = 0; d < 3; ++d) {
    if (s.outside[d]) gradient[d] = 0;
  }
  const double far = std::sqrt(s.beyond.squaredNorm() + f * f);
  return {far, (s.beyond + f * gradient) / far};
}

Mat3 SampledDistance::hessian(const Vec3& x) const {
  const Stencil s = locate(x);
  double f = 0;
  Vec3 gradient = Vec3::Zero();
  Mat3 hessian = Mat3::Zero();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) {
        const double d = node(s.first[0] + i, s.first[1] + j, s.first[2] + k);
        const double wx = s.weight[0][i], wy = s.weight[1][j], wz = s.weight[2][k];
        const double sx = s.slope[0][i], sy = s.slope[1][j], sz = s.slope[2][k];
        f += wx * wy * wz * d;
        gradient += d * Vec3(sx * wy * wz, wx * sy * wz, wx * wy * sz);
        hessian(0, 0) += s.bend[0][i] * wy * wz * d;
        hessian(1, 1) += wx * s.bend[1][j] * wz * d;
        hessian(2, 2) += wx * wy * s.bend[2][k] * d;
        hessian(0, 1) += sx * sy * wz * d;
        hessian(0, 2) += sx * wy * sz * d;
        hessian(1, 2) += wx * sy * sz * d;
      }
    }
  }
  hessian(1, 0) = hessian(0, 1);
  hessian(2, 0) = hessian(0, 2);
  hessian(2, 1) = hessian(1, 2);
  if (!(s.outside[0] || s.outside[1] || s.outside[2])) return hessian;
  // F = sqrt(|x - c|^2 + f(c)^2): F grad F^T + F H = P + J (g g^T + f H) J, where P keeps the axes
  // along which x was moved and J = 1 - P.
  Vec3 moved;
  for (int d = 0; d < 3; ++d) moved[d] = s.outside[d] ? 1 : 0;
  const Mat3 keep = (Vec3::Ones() - moved).asDiagonal();
  const double far = std::sqrt(s.beyond.squaredNorm() + f * f);
  const Vec3 slope = (s.beyond + f * (keep * gradient)) / far;
  const Mat3 squared =
      Mat3(moved.asDiagonal()) + keep * (gradient * gradient.transpose() + f * hessian) * keep;
  return (squared - slope * slope.transpose()) / far;
}

}  // namespace substep::geometry
