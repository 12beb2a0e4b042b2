// P A Q = L U for general square sparse A, real or complex: by UMFPACK (Davis, "Algorithm 832:
// UMFPACK", ACM TOMS 30 (2004) 196), whose dense fronts suit meshes, or by KLU (Davis, Palamadai
// Natarajan, "Algorithm 907: KLU", ACM TOMS 37 (2010) 36), which suits chains and circuits.
#pragma once

#include <complex>
#include <cstdint>
#include <memory>
#include <span>

#include "substep/linalg/sparse.h"

namespace substep {

enum class LUKind { automatic, umfpack, klu };  // umfpack needs SUBSTEP_GPL

struct LUReport {
  bool factorized = false;          // whether solve() may be called
  LUKind kind = LUKind::automatic;  // the one chosen
  double factor_entries = 0;        // nonzeros of L and U
  double rcond = 0;                 // min |u_ii| / max |u_ii|: a cheap estimate of 1 / cond(A)
  std::int64_t analyses = 0, factorizations = 0;
};

// What factors of A + A^T would cost in AMD's order, whatever the values.
struct FactorCost {
  double operations = 0, entries = 0;
};
FactorCost factor_cost(const SparsePattern& pattern);  // throws std::bad_alloc

// T is double or std::complex<double>.
template <class T>
class LU {
 public:
  // Analyses the pattern of a square matrix. Throws InputError, std::bad_alloc.
  explicit LU(SparsePattern pattern, LUKind kind = LUKind::automatic);
  LU(LU&&) noexcept;
  LU& operator=(LU&&) noexcept;
  ~LU();

  // Values in the order of the pattern's entries. Throws NonFiniteError, SingularMatrixError with
  // the row, std::bad_alloc; the object can be used again afterwards.
  const LUReport& factor(std::span<const T> values);

  // x = A^-1 b, or A^-T b without conjugation, for `columns` right-hand sides, one after the other;
  // b and x may be the same. Throws SingularMatrixError if there is no factor.
  void solve(std::span<const T> b, std::span<T> x, std::int32_t columns = 1,
             bool transpose = false);

  const LUReport& report() const;
  const SparsePattern& pattern() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace substep
