// Krylov methods for A x = b with A known by its products only. Sums run in a fixed order, so that
// the bits do not depend on the number of threads (if those of the operator do not).
#pragma once

#include <complex>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace substep {

// y = A x. A preconditioner is the operator z = M^-1 r; an empty one is the identity.
template <class T>
using LinearOperator = std::function<void(std::span<const T> x, std::span<T> y)>;

struct KrylovOptions {
  double rtol = 1e-8, atol = 0;     // stops at |b - A x|_2 <= max(rtol |b|_2, atol)
  std::int32_t max_iterations = 0;  // 0: twice the number of unknowns, at least 100
  int threads = 0;
};

struct KrylovReport {
  bool converged = false;
  bool indefinite = false;        // cg met a direction with p . A p <= 0
  std::int32_t iterations = 0;    // products with A, for bicgstab pairs of them
  std::vector<double> residuals;  // |b - A x|_2 as the recurrence has it, before and after each one
  std::string remedy;             // what to try where it did not converge
};

// Conjugate gradients (Hestenes, Stiefel 1952; Saad, "Iterative Methods for Sparse Linear Systems",
// 2nd ed., algorithm 9.1) for symmetric positive definite A and M. x holds the first guess and
// becomes the answer, or the last iterate. Throws NonFiniteError, with x as it was.
KrylovReport cg(const LinearOperator<double>& a, std::span<const double> b, std::span<double> x,
                const KrylovOptions& options = {}, const LinearOperator<double>& precondition = {});

// BiCGSTAB (van der Vorst, SIAM J. Sci. Stat. Comput. 13 (1992) 631), preconditioned from the
// right, for general A; T is double or std::complex<double>. Restarts where its recurrence breaks
// down.
template <class T>
KrylovReport bicgstab(const LinearOperator<T>& a, std::span<const T> b, std::span<T> x,
                      const KrylovOptions& options = {},
                      const LinearOperator<T>& precondition = {});

}  // namespace substep
