// The pressure (pressure_solver.h) of a fluid that fills a box without obstacles, found directly:
// the matrix is a sum of second differences along each axis, so transforms along all axes
// (line_transform.h) make it diagonal.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/grid/sides.h"
#include "substep/gridfluid/pressure/line_transform.h"
#include "substep/gridfluid/pressure/pressure_solver.h"

namespace substep::gridfluid {

template <class Real, int D>
class TransformSolver {
 public:
  using Coefficients = typename PressureSolver<Real, D>::Coefficients;

  static bool can(const Layout<D>& layout);  // whether no number of cells has a large prime factor
  TransformSolver(const Layout<D>& layout, const OpenSides<D>& open);
  // p is 0 in what is not fluid, before and after. w, of PressureSolver, is that of the box, and
  // used for the residual.
  SolveReport solve(const Coefficients& w, std::span<const Real> b, std::span<double> p,
                    int threads = 0) const;

 private:
  using Sums = std::array<double, 2>;

  std::int64_t slabs() const;
  template <class Use>
  void for_row_groups(std::int64_t slab, const Use& use) const;
  template <class Use>
  void for_middle(std::int64_t slab, double* p, const Use& use) const;
  Sums transform(std::span<const Real> b, double* p, int threads) const;
  void divide(double* p, int threads) const;
  void divide(double* p, std::int64_t row, int column, double* z) const;
  void transform_back(double* p, int threads) const;
  Sums residual(const Coefficients& w, std::span<const Real> b, double mean, double* p,
                int threads) const;

  Layout<D> layout_;
  std::vector<LineTransform> along_;  // each axis
  std::vector<double> eigenvalues_;   // of the last axis, and beyond
  bool closed_ = true;
  std::size_t room_ = 0;  // of the longest lines
};

extern template class TransformSolver<float, 2>;
extern template class TransformSolver<float, 3>;
extern template class TransformSolver<double, 2>;
extern template class TransformSolver<double, 3>;

}  // namespace substep::gridfluid
