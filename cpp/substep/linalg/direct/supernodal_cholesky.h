// Sparse Cholesky factorization A = L L^T of symmetric positive definite matrices, multifrontal
// (Duff and Reid, ACM TOMS 9 (1983) 302-325; Liu, SIAM Review 34 (1992) 82-109), for matrices with
// dense 3 x 3 blocks or scalar ones. Columns of a supernode and the update of its ancestors are a
// dense front; subtrees of the elimination tree are tasks, and the large fronts above them are
// shared out by rows. Every sum has one order, so the bits do not depend on the number of threads.
// Real is what it computes in, float64 or float32, for values and solutions in float64.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/linalg/direct/cholesky.h"
#include "substep/linalg/direct/panel_kernels.h"
#include "substep/linalg/direct/supernodes.h"

namespace substep {

template <class Real = double>
class SupernodalCholesky {
 public:
  // The lower triangle. With block = 3 the unknowns 3 i, 3 i + 1, 3 i + 2 belong to vertex i; else
  // block = 1. Ordering::automatic: metis from 5000 vertices on. Throws InputError, std::bad_alloc.
  SupernodalCholesky(const SparsePattern& lower, std::int32_t block,
                     Ordering ordering = Ordering::automatic);
  // With the structure of another one of the same pattern, which takes longest to find.
  SupernodalCholesky(const SparsePattern& lower, std::int32_t block, Supernodes tree);
  ~SupernodalCholesky();
  SupernodalCholesky(const SupernodalCholesky&) = delete;
  SupernodalCholesky& operator=(const SupernodalCholesky&) = delete;

  // Values in the order of the pattern's entries. Returns -1, or the unknown at which the matrix
  // turned out not to be positive definite (NaN is not): an answer, and solve() then has no
  // meaning.
  std::int64_t factorize(std::span<const double> values, int threads = 0);

  // x = A^-1 b in place; three numbers for each vertex, which are its unknowns where block = 3 and
  // those of three right-hand sides where block = 1.
  void solve(std::span<double> x, int threads = 0);
  // The same for several right-hand sides: three at once take less than three times as long.
  void solve(std::span<std::vector<double>> x, int threads = 0);

  const Supernodes& structure() const { return tree_; }
  double flops() const { return flops_; }              // of one factorization
  std::int64_t nonzeros() const { return nonzeros_; }  // of L

 private:
  static constexpr std::int64_t kPanel = kPanelRows<Real>;
  struct Front;
  enum class Part { columns, update };
  void map_values(const SparsePattern& lower);
  void choose_tasks();
  void clear_columns(std::int64_t s, std::span<const double> values);
  void add_child(std::int64_t child, const Real* child_update, std::int64_t s, Part part,
                 Real* update, int threads);
  std::int64_t eliminate(std::int64_t s, Real* update, int threads);
  std::int64_t run_task(std::int64_t root, std::span<const double> values);
  template <int kRows, int kSides>
  void forward_front(std::int64_t s);
  template <int kRows, int kSides>
  void backward_front(std::int64_t s);
  template <int kRows, int kSides>
  void solve_sides(int threads);

  std::int32_t block_;
  Supernodes tree_;
  std::vector<Front> fronts_;
  std::vector<std::vector<std::int32_t>> children_;
  std::vector<Real> factor_;    // the panels of all fronts
  std::vector<Real> inverses_;  // 1 / L_jj
  std::vector<std::int64_t> value_starts_;
  std::vector<std::int32_t> value_targets_, value_sources_;
  std::vector<std::int64_t> task_roots_, task_first_, top_;  // subtrees, and what is above them
  std::vector<std::vector<Real>> kept_updates_;              // of roots of tasks, and of the top
  std::vector<Real> solution_, updates_;                     // of solve(), in the factor's order
  double flops_ = 0.0;
  std::int64_t nonzeros_ = 0;
};

extern template class SupernodalCholesky<double>;
extern template class SupernodalCholesky<float>;

}  // namespace substep
