// A sparse Cholesky factorization in float32, which takes half the time and half the memory of one
// in float64, for solutions in float64: it is the preconditioner of conjugate gradients with the
// matrix itself, of which each iteration brings some four digits (Higham, Mary, "Mixed precision
// algorithms in numerical linear algebra", Acta Numerica 31 (2022) 347-414, section 8.4). Where the
// condition or the range of a matrix is beyond float32 it is factorized in float64. Whether a
// matrix is positive definite is float64's to deny; float32 can only take one for positive definite
// that is not by less than its rounding.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/linalg/direct/supernodal_cholesky.h"

namespace substep {

class MixedCholesky {
 public:
  // As those of SupernodalCholesky.
  MixedCholesky(const SparsePattern& lower, std::int32_t block);

  // A matrix that was beyond float32 has those after it taken to be so too, until this.
  void forget() { beyond_single_ = false; }
  // Matrices are factorized in float64, until forget().
  void take_double() { beyond_single_ = true; }
  // Whether the last one was.
  bool in_double() const { return in_double_; }

  std::int64_t size() const { return lower_.cols; }
  // y = A x
  void multiply(std::span<const double> values, std::span<const double> x,
                std::span<double> y) const;

  // As SupernodalCholesky::factorize.
  std::int64_t factorize(std::span<const double> values, int threads);

  // x = A^-1 b in place, good to what the factor is: a preconditioner, positive definite whatever
  // A.
  void solve(std::span<double> x, int threads);
  void solve(std::span<std::vector<double>> x, int threads);  // for several right-hand sides

  // The same to |b - A x| <= rtol |b|; `values` are those that were factorized. Returns false where
  // A turns out not to be positive definite, by less than float32 sees: x is that of the other
  // solve().
  bool solve(std::span<double> x, std::span<const double> values, double rtol, int threads);

 private:
  std::int64_t factorize_in_double(std::span<const double> values, int threads);

  SparsePattern lower_;
  std::int32_t block_;
  SupernodalCholesky<float> single_;
  std::unique_ptr<SupernodalCholesky<double>> double_;  // made for the first matrix that needs it
  bool in_double_ = false;                              // where the factor is
  bool beyond_single_ = false;
};

}  // namespace substep
