#include "substep/springs/bordered_cholesky.h"

#include <algorithm>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/krylov.h"

namespace substep::springs {
namespace {

constexpr double kLeastLeft = 1e-3;  // of the border's corners, in a Schur complement of float32
constexpr int kMostBorderedIterations = 8;  // of conjugate gradients, as without a border
constexpr int kMostIterationsWithoutRoom = 40;
constexpr std::size_t kFew = 8;  // vertices

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

// C^T x of a body.
Vec6 touched_by(const Border& border, std::size_t body, std::span<const double> x) {
  Vec6 sum = Vec6::Zero();
  for (const Border::Touch& touch : border.touches[body]) {
    sum += touch.block.transpose() * const_three(x, touch.vertex);
  }
  return sum;
}
// y += C z
void touch(const Border& border, std::size_t body, const Vec6& z, std::span<double> y) {
  for (const Border::Touch& touch : border.touches[body]) {
    three(y, touch.vertex) += touch.block * z;
  }
}

}  // namespace

bool BorderedCholesky::factorize(std::span<const double> values, const Border& border,
                                 int threads) {
  if (!eliminate_few(values, border)) return false;
  if (cholesky_.factorize(values_, threads) >= 0) return false;
  const double left = eliminate_bodies(border, threads);
  if (cholesky_.in_double() || left >= kLeastLeft) return left > 0.0;
  cholesky_.take_double();
  return cholesky_.factorize(values_, threads) < 0 && eliminate_bodies(border, threads) > 0.0;
}

// Returns whether their corners are positive definite.
bool BorderedCholesky::eliminate_few(std::span<const double> values, const Border& border) {
  few_.clear();
  touched_.clear();
  has_room_ = true;
  values_.assign(values.begin(), values.end());
  for (std::size_t b = 0; b < border.touches.size(); ++b) {
    const std::vector<Border::Touch>& touches = border.touches[b];
    if (touches.empty()) continue;
    if (borders_all_ || touches.size() > kFew) {
      touched_.push_back(b);
      continue;
    }
    few_.push_back({b, Eigen::LLT<Mat6>(border.corners[b])});
    if (few_.back().corner.info() != Eigen::Success) return false;
    const auto is_neighbour = [&](const Border::Touch& i, const Border::Touch& j) {
      return lower_.find(3 * std::max(i.vertex, j.vertex), 3 * std::min(i.vertex, j.vertex)) >= 0;
    };
    bool all = true;
    for (const Border::Touch& i : touches) {
      for (const Border::Touch& j : touches) all = all && is_neighbour(i, j);
    }
    has_room_ = has_room_ && all;
    for (const Border::Touch& j : touches) {
      const Mat36 given = few_.back().corner.solve(j.block.transpose()).transpose();
      for (const Border::Touch& i : touches) {
        if (i.vertex < j.vertex || (i.vertex != j.vertex && !all)) continue;
        const Mat3 block = i.block * given.transpose();
        for (int c = 0; c < 3; ++c) {
          const int first = i.vertex == j.vertex ? c : 0;
          const std::int32_t at = lower_.find(3 * i.vertex + first, 3 * j.vertex + c);
          for (int r = first; r < 3; ++r) values_[usize(at + r - first)] -= block(r, c);
        }
      }
    }
  }
  return true;
}

// Returns how much of the border's corners is left in pivots of the Schur complement, at least; 0
// where that is not positive definite.
double BorderedCholesky::eliminate_bodies(const Border& border, int threads) {
  columns_.clear();
  for (const std::size_t b : touched_) {
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
  substitute_few(border, b);
  solve_rest(border, b, threads);
  recover_few(border, b);
}

bool BorderedCholesky::solve(std::span<const double> values, const Border& border,
                             std::span<double> b, double rtol, int threads) {
  if (touched_.empty() && has_room_) {
    substitute_few(border, b);
    const bool definite = cholesky_.solve(parts(border, b).x, values_, rtol, threads);
    substitute(border, b);
    recover_few(border, b);
    return definite;
  }
  if (cholesky_.in_double() && has_room_) {
    solve(border, b, threads);
    return true;
  }
  const std::vector<double> right(b.begin(), b.end());
  substitute_few(border, b);
  std::vector<double> rest(b.begin(), b.end());
  for (const Few& few : few_) Eigen::Map<Vec6>{&parts(border, rest).z[6 * few.body]}.setZero();
  const auto product = [&](std::span<const double> p, std::span<double> of) {
    multiply(values, border, p, of);
  };
  const auto precondition = [&](std::span<const double> r, std::span<double> z) {
    std::copy(r.begin(), r.end(), z.begin());
    solve_rest(border, z, threads);
  };
  std::vector<double> x(b.size(), 0.0);
  const KrylovOptions options{
      .rtol = rtol,
      .max_iterations = has_room_ ? kMostBorderedIterations : kMostIterationsWithoutRoom,
      .threads = threads};
  try {
    if (cg(product, rest, x, options, precondition).converged) {
      for (const Few& few : few_) {
        Eigen::Map<Vec6>{&parts(border, x).z[6 * few.body]} =
            Eigen::Map<const Vec6>{&parts(border, b).z[6 * few.body]};
      }
      recover_few(border, x);
      std::copy(x.begin(), x.end(), b.begin());
      return true;
    }
  } catch (const NonFiniteError&) {  // beyond the range of float32
  }
  cholesky_.take_double();
  borders_all_ = true;
  const bool definite = factorize(values, border, threads);
  if (!definite) {
    forget();
    factorize(values, border, threads);
  }
  std::copy(right.begin(), right.end(), b.begin());
  solve(border, b, threads);
  return definite;
}

// z = S^-1 b_z of bodies that few touch, and what that leaves of b_x.
void BorderedCholesky::substitute_few(const Border& border, std::span<double> b) const {
  const auto [x, z] = parts(border, b);
  for (const Few& few : few_) {
    Eigen::Map<Vec6> own{&z[6 * few.body]};
    own = few.corner.solve(Vec6(own));
    touch(border, few.body, -own, x);
  }
}

// z -= S^-1 C^T x
void BorderedCholesky::recover_few(const Border& border, std::span<double> b) const {
  const auto [x, z] = parts(border, b);
  for (const Few& few : few_) {
    Eigen::Map<Vec6>{&z[6 * few.body]} -= few.corner.solve(touched_by(border, few.body, x));
  }
}

// Of all but the bodies that few touch.
void BorderedCholesky::solve_rest(const Border& border, std::span<double> b, int threads) {
  cholesky_.solve(parts(border, b).x, threads);
  substitute(border, b);
}

// y = A x with the bodies that few touch eliminated, whose part of x is 0.
void BorderedCholesky::multiply(std::span<const double> values, const Border& border,
                                std::span<const double> x, std::span<double> y) const {
  const std::size_t vertices = usize(cholesky_.size());
  const std::span<const double> z = x.subspan(vertices);
  const auto to = parts(border, y);
  cholesky_.multiply(values, x.first(vertices), to.x);
  for (std::size_t k = 0; k < border.corners.size(); ++k) {
    const Eigen::Map<const Vec6> own{&z[6 * k]};
    Eigen::Map<Vec6>{&to.z[6 * k]} = border.corners[k] * own + touched_by(border, k, x);
    touch(border, k, own, to.x);
  }
  for (const Few& few : few_) {
    Eigen::Map<Vec6> gone{&to.z[6 * few.body]};
    touch(border, few.body, -few.corner.solve(Vec6(gone)), to.x);
    gone.setZero();
  }
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
