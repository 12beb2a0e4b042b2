// z = M^-1 r for Krylov methods. The results own what they need, but keep no reference to `pattern`
// or `values` (zero diagonals and blocks that are singular count as the identity).
#pragma once

#include "substep/linalg/krylov.h"
#include "substep/linalg/sparse.h"

namespace substep {

// M = diag(A).
template <class T>
LinearOperator<T> diagonal_preconditioner(const SparsePattern& pattern, std::span<const T> values,
                                          int threads = 0);

// M = the block x block squares on the diagonal of A, inverted. For a lower triangle, which stands
// for a symmetric matrix, say so.
LinearOperator<double> block_diagonal_preconditioner(const SparsePattern& pattern,
                                                     std::span<const double> values,
                                                     std::int32_t block, bool lower,
                                                     int threads = 0);

// M = L L^T with the pattern of the lower triangle of A, incomplete Cholesky IC(0) (Meijerink, van
// der Vorst 1977). Where a pivot is not positive, the diagonal is raised and the factorization
// begins again (Manteuffel 1980).
LinearOperator<double> incomplete_cholesky(const SparsePattern& lower,
                                           std::span<const double> values);

// M = L U with the pattern of A, ILU(0) (Saad, algorithm 10.4).
template <class T>
LinearOperator<T> incomplete_lu(const SparsePattern& pattern, std::span<const T> values);

}  // namespace substep
