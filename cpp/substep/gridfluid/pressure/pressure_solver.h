// The pressure of a fluid on a grid: for each fluid cell i
//   sum over its 2 D faces f of w_f (p_i - p_j) = b_i,
// with p = 0 in air. w_f is the open part of the face over the density (Batty, Bertails and
// Bridson, "A fast variational framework for accurate solid-fluid coupling", 2007), 0 at solid
// faces; at a face between fluid and air it is divided by theta in (0, 1], how far from cell i the
// surface is (the ghost fluid method: Gibou, Fedkiw, Cheng and Kang, "A second-order-accurate
// symmetric discretization of the Poisson equation on irregular domains", 2002, eq. 20).
//
// Conjugate gradients, preconditioned by multigrid (multigrid.h); where that stalls, by the
// diagonal. Directions are Real; p is a sum of them in double, and so are A p and all sums: so that
// float32 vectors do for a column of any depth.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/pressure/bodies.h"
#include "substep/gridfluid/pressure/multigrid.h"
#include "substep/gridfluid/pressure/regions.h"

namespace substep::gridfluid {

enum class Preconditioner { kMultigrid, kDiagonal };

struct SolveReport {
  int iterations = 0;
  double residual = 0;  // |b - A p| / |b|
  bool converged = false;
  bool direct = false;  // found by transforms (transform_solver.h), whatever the tolerance
  Preconditioner preconditioner = Preconditioner::kMultigrid;  // that was used last
  int closed_regions = 0;  // that no air touches; the mean of p is 0 in each, that of b taken out
  double imbalance = 0;    // the largest |sum of b| over one of those / sum of |b| over all cells
};

template <class Real, int D>
class PressureSolver {
 public:
  using Coefficients = std::array<std::span<const Real>, D>;

  explicit PressureSolver(const Layout<D>& layout);
  // Arrays of the layout, which must live, and not change, as long as the matrix is used. w[a][i]:
  // of the face between cells i and i - stride[a]; on a periodic axis that of face n is that of 0.
  void set_matrix(const Coefficients& w, std::span<const Cell> cells, int threads = 0);
  // p: a first guess in, the solution out; 0 in all cells that are not fluid. Stops where
  // |b - A p| <= tolerance |b|. bodies: that yield, if any, for which A has further terms.
  SolveReport solve(std::span<const Real> b, std::span<double> p, double tolerance,
                    int max_iterations, int threads = 0, const Bodies<Real, D>* bodies = nullptr);
  const FluidRows<D>& fluid() const { return multigrid_.fluid(); }
  // Of the diagonal of A, 0 where there is no pressure.
  std::span<const Real> inverse_diagonal() const {
    const AlignedBuffer<Real>& inverse = multigrid_.inverse_diagonal();
    return {inverse.data(), inverse.size()};
  }
  std::size_t bytes() const;  // of memory, beside w and cells

 private:
  enum class End { kGoal, kStalled, kUsedUp };
  End iterate(std::span<double> p, double goal, int max_iterations, SolveReport& report,
              int threads);
  double set_right_side(std::span<const Real> b, SolveReport& report, int threads);
  double subtract_product(std::span<const double> p, int threads);
  double precondition(Preconditioner preconditioner, int threads);
  double next_direction(Real beta, int threads);
  double move(double alpha, std::span<double> p, int threads);
  void clear(std::span<double> p, bool keep, int threads);
  template <class Use>
  double sum_rows(const Use& use, int threads);
  template <class Term>
  double sum_of(const Term& term, int threads);
  double norm_of_r(int threads);
  double sum_parts() const;

  Layout<D> layout_;
  Coefficients w_;
  Multigrid<Real, D> multigrid_;
  ClosedRegions<Real, D> regions_;
  const Bodies<Real, D>* bodies_ = nullptr;  // of the system that is being solved
  AlignedBuffer<Real> r_, z_, d_, q_;        // residual, M r, direction, A d
  AlignedBuffer<Real> rest_;                 // of r, without what moves bodies
  std::vector<double> parts_;                // of a sum
};

extern template class PressureSolver<float, 2>;
extern template class PressureSolver<float, 3>;
extern template class PressureSolver<double, 2>;
extern template class PressureSolver<double, 3>;

}  // namespace substep::gridfluid
