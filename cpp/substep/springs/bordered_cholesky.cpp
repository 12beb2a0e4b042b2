#include "substep/springs/bordered_cholesky.h"

#include <algorithm>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/krylov.h"

namespace substep::springs {
namespace {

constexpr double kLeastLeft = 1e-3;  // of the border's corners, in a Schur complement of float32
constexpr int kMostBorderedIterations = 8;  // of conjugate gradients, as without a border

struct BorderedVector {
  std::span<double> x, z;
};
BorderedVector parts(const Border& border, std::span<double> b) {
  const std::size_t unknowns = 6 * border.corners.size();
  return {b.first(b.size() - unknowns), b.last(unknowns)};
}

Eigen::Map<Vec3> three(std::span<double> x, std::int32_t vertex) {
  return Eigen::Map<Vec3>{&x[3 * usize(vertex)]};
}
Eigen::Map<const Vec3> const_three(std::span<const double> x, std::int32_t vertex) {
  return Eigen::Map<const Vec3>{&x[3 * usize(vertex)]};
}

// y += what the border adds to A x.
void multiply_border(const Border& border, std::span<const double> x, std::span<double> y) {
  const std::size_t bodies = border.corners.size();
  const std::size_t first = x.size() - 6 * bodies;
  for (std::size_t k = 0; k < bodies; ++k) {
    const Eigen::Map<const Vec6> z{&x[first + 6 * k]};
    Vec6 sum = border.corners[k] * z;
    for (const Border::Touch& touch : border.touches[k]) {
      three(y, touch.vertex) += touch.block * z;
      sum += touch.block.transpose() * const_three(x, touch.vertex);
    }
    Eigen::Map<Vec6>{&y[first + 6 * k]} += sum;
  }
}

}  // namespace

bool BorderedCholesky::factorize(std::span<const double> values, const Border& border,
                                 int threads) {
  if (cholesky_.factorize(values, threads) >= 0) return false;
  const double left = eliminate_bodies(border, threads);
  if (cholesky_.in_double() || left >= kLeastLeft) return left > 0.0;
  cholesky_.take_double();
  return cholesky_.factorize(values, threads) < 0 && eliminate_bodies(border, threads) > 0.0;
}

// Returns how much of the border's corners is left in pivots of the Schur complement, at least; 0
// where that is not positive definite.
double BorderedCholesky::eliminate_bodies(const Border& border, int threads) {
  touched_.clear();
  columns_.clear();
  for (std::size_t b = 0; b < border.touches.size(); ++b) {
    if (border.touches[b].empty()) continue;
    touched_.push_back(b);
    for (Eigen::Index c = 0; c < 6; ++c) {
      std::vector<double> column(usize(cholesky_.size()));
      for (const Border::Touch& touch : border.touches[b]) {
        three(column, touch.vertex) += touch.block.col(c);
      }
      columns_.push_back(std::move(column));
    }
  }
  cholesky_.solve(std::span(columns_), threads);
  const auto size = static_cast<Eigen::Index>(columns_.size());
  Eigen::MatrixXd schur = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd corners(size);
  for (Eigen::Index k = 0; k < size / 6; ++k) {
    const std::size_t b = touched_[usize(k)];
    schur.block<6, 6>(6 * k, 6 * k) = border.corners[b];
    corners.segment<6>(6 * k) = border.corners[b].diagonal();
    for (const Border::Touch& touch : border.touches[b]) {
      for (Eigen::Index c = 0; c < size; ++c) {
        schur.block<6, 1>(6 * k, c) -=
            touch.block.transpose() * const_three(columns_[usize(c)], touch.vertex);
      }
    }
  }
  schur_.compute(schur);
  if (schur_.info() != Eigen::Success) return 0.0;
  const Eigen::MatrixXd& factor = schur_.matrixLLT();
  double left = 1.0;
  for (Eigen::Index c = 0; c < size; ++c) {
    left = std::min(left, factor(c, c) * factor(c, c) / corners[c]);
  }
  return left;
}

void BorderedCholesky::solve(const Border& border, std::span<double> b, int threads) {
  cholesky_.solve(parts(border, b).x, threads);
  substitute(border, b);
}

bool BorderedCholesky::solve(std::span<const double> values, const Border& border,
                             std::span<double> b, double rtol, int threads) {
  if (touched_.empty()) {
    const bool definite = cholesky_.solve(parts(border, b).x, values, rtol, threads);
    substitute(border, b);
    return definite;
  }
  if (cholesky_.in_double()) {
    solve(border, b, threads);
    return true;
  }
  const std::vector<double> right(b.begin(), b.end());
  const auto multiply = [&](std::span<const double> p, std::span<double> product) {
    std::fill(product.begin(), product.end(), 0.0);
    const std::size_t vertices = usize(cholesky_.size());
    cholesky_.multiply(values, p.first(vertices), product.first(vertices));
    multiply_border(border, p, product);
  };
  const auto precondition = [&](std::span<const double> r, std::span<double> z) {
    std::copy(r.begin(), r.end(), z.begin());
    solve(border, z, threads);
  };
  std::fill(b.begin(), b.end(), 0.0);
  const KrylovOptions options{
      .rtol = rtol, .max_iterations = kMostBorderedIterations, .threads = threads};
  try {
    if (cg(multiply, right, b, options, precondition).converged) return true;
  } catch (const NonFiniteError&) {  // beyond the range of float32
  }
  cholesky_.take_double();
  const bool definite = factorize(values, border, threads);
  if (!definite) {
    cholesky_.forget();
    factorize(values, border, threads);
  }
  std::copy(right.begin(), right.end(), b.begin());
  solve(border, b, threads);
  return definite;
}

// With x = K^-1 b_x, (x, z) = A^-1 b.
void BorderedCholesky::substitute(const Border& border, std::span<double> b) const {
  const auto [x, z] = parts(border, b);
  for (std::size_t k = 0; k < border.corners.size(); ++k) {
    if (border.touches[k].empty()) Eigen::Map<Vec6>{&z[6 * k]} /= border.corners[k](0, 0);
  }
  if (touched_.empty()) return;
  Eigen::VectorXd right(static_cast<Eigen::Index>(columns_.size()));
  for (std::size_t k = 0; k < touched_.size(); ++k) {
    Vec6 sum = Eigen::Map<const Vec6>{&z[6 * touched_[k]]};
    for (const Border::Touch& touch : border.touches[touched_[k]]) {
      sum -= touch.block.transpose() * const_three(x, touch.vertex);
    }
    right.segment<6>(static_cast<Eigen::Index>(6 * k)) = sum;
  }
  schur_.solveInPlace(right);
  for (std::size_t c = 0; c < columns_.size(); ++c) {
    const double amount = right[static_cast<Eigen::Index>(c)];
    z[6 * touched_[c / 6] + c % 6] = amount;
    for (std::size_t i = 0; i < x.size(); ++i) x[i] -= amount * columns_[c][i];
  }
}

}  // namespace substep::springs
