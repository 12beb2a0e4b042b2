// A = L L^T for symmetric positive definite sparse A, by CHOLMOD (Chen, Davis, Hager, Rajamanickam,
// "Algorithm 887: CHOLMOD", ACM TOMS 35 (2008) 22). A pattern is analysed once; its values are
// factorized as often as they change.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "substep/linalg/sparse.h"

namespace substep {

// The order of elimination. natural keeps that of the matrix; automatic: see cholesky.cpp.
enum class Ordering { automatic, amd, metis, natural };
// simplicial goes column by column, supernodal by dense blocks of columns (needs SUBSTEP_GPL).
enum class CholeskyKind { automatic, simplicial, supernodal };

struct CholeskyOptions {
  Ordering ordering = Ordering::automatic;
  CholeskyKind kind = CholeskyKind::automatic;
  // Unknowns 3 i, 3 i + 1, 3 i + 2 belong to vertex i (block = 3): vertices are ordered, not
  // unknowns. Needs rows that are a multiple of `block`.
  std::int32_t block = 1;
};

struct CholeskyReport {
  bool factorized = false;   // whether solve() may be called
  std::int32_t column = -1;  // where A turned out not to be positive definite, else -1
  bool supernodal = false;
  Ordering ordering = Ordering::automatic;  // the one chosen
  double factor_entries = 0;                // nonzeros of L
  double flops = 0;                         // of one factorization
  std::int64_t analyses = 0, factorizations = 0;
};

class Cholesky {
 public:
  // Analyses the lower triangle of a symmetric matrix. Throws InputError, std::bad_alloc.
  explicit Cholesky(SparsePattern lower, const CholeskyOptions& options = {});
  Cholesky(Cholesky&&) noexcept;
  Cholesky& operator=(Cholesky&&) noexcept;
  ~Cholesky();

  // Values in the order of the pattern's entries. A matrix that is not positive definite is an
  // answer: report().factorized is false and report().column says where. Throws NonFiniteError,
  // std::bad_alloc; the object can be used again afterwards.
  const CholeskyReport& factor(std::span<const double> values);

  // x = A^-1 b for `columns` right-hand sides, one after the other; b and x may be the same.
  // Throws SingularMatrixError if there is no factor.
  void solve(std::span<const double> b, std::span<double> x, std::int32_t columns = 1);

  const CholeskyReport& report() const;
  const SparsePattern& pattern() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace substep
