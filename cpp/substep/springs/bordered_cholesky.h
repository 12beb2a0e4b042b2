// A Cholesky factorization of the Hessian of a step with bodies (bodies.h): that of the vertices, K
// (mixed_cholesky.h), and a border of six rows for each body,
//
//   [K   C]
//   [C^T S],   eliminated by the Schur complement S - C^T K^-1 C of those that are touched.
//
// As K alone, the whole is factorized in float32, as the preconditioner of conjugate gradients with
// the matrix itself. The Schur complement is a difference: what the contacts resist by, less what
// the vertices give way. Of a body much lighter than these it is small, and where float32 would
// leave too few digits of it the factorization is in float64.
//
// Triangles of a surface are many bodies, each touched by few vertices. Such a body is eliminated
// first, which leaves K - C S^-1 C^T for these vertices: their contacts and the body, one after the
// other. What of it K has no place for, blocks of vertices that are no neighbours, conjugate
// gradients make up for; where they cannot, all bodies are in the border.
#pragma once

#include <Eigen/Cholesky>
#include <span>
#include <vector>

#include "substep/linalg/direct/mixed_cholesky.h"
#include "substep/springs/bodies.h"

namespace substep::springs {

class BorderedCholesky {
 public:
  // The lower triangle of K, with 3 x 3 blocks.
  explicit BorderedCholesky(const SparsePattern& lower) : lower_(lower), cholesky_(lower, 3) {}

  // As MixedCholesky::forget.
  void forget() {
    cholesky_.forget();
    borders_all_ = false;
  }

  // Returns whether the matrix is positive definite.
  bool factorize(std::span<const double> values, const Border& border, int threads);

  // (x, z) = A^-1 b in place, good to what the factor is.
  void solve(const Border& border, std::span<double> b, int threads);
  // The same to |b - A (x, z)| <= rtol |b|, with what was factorized. Returns false where A turns
  // out not to be positive definite: (x, z) is that of the other solve().
  bool solve(std::span<const double> values, const Border& border, std::span<double> b, double rtol,
             int threads);

 private:
  bool eliminate_few(std::span<const double> values, const Border& border);
  double eliminate_bodies(const Border& border, int threads);
  void substitute_few(const Border& border, std::span<double> b) const;
  void recover_few(const Border& border, std::span<double> b) const;
  void solve_rest(const Border& border, std::span<double> b, int threads);
  void substitute(const Border& border, std::span<double> b) const;
  void multiply(std::span<const double> values, const Border& border, std::span<const double> x,
                std::span<double> y) const;

  SparsePattern lower_;
  MixedCholesky cholesky_;
  struct Few {
    std::size_t body;
    Eigen::LLT<Mat6> corner;
  };
  std::vector<Few> few_;
  std::vector<double> values_;  // of K without these
  bool has_room_ = true;        // for all that they leave
  bool borders_all_ = false;
  std::vector<std::size_t> touched_;          // of the others
  std::vector<std::vector<double>> columns_;  // of K^-1 C, 6 for each body touched
  Eigen::LLT<Eigen::MatrixXd> schur_;
};

}  // namespace substep::springs
