// Placeholder interface of the pressure solver.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/cells.h"
#include "substep/gridfluid/layout.h"

namespace substep::gridfluid {

struct SolveReport {
  int iterations = 0;
  double residual = 0;
  bool converged = true;
};

template <class Real, int D>
class PressureSolver {
 public:
  explicit PressureSolver(const Layout<D>& layout) : layout_(layout) {}
  void set_matrix(std::array<std::span<const Real>, D> w, std::span<const Cell> cells, int threads);
  SolveReport solve(std::span<const Real> b, std::span<double> p, double tolerance,
                    int max_iterations, int threads);

 private:
  Layout<D> layout_;
  std::array<std::span<const Real>, D> w_;
  std::span<const Cell> cells_;
};

extern template class PressureSolver<float, 2>;
extern template class PressureSolver<float, 3>;
extern template class PressureSolver<double, 2>;
extern template class PressureSolver<double, 3>;

}  // namespace substep::gridfluid
