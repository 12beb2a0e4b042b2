// The linear system of an implicit viscosity: symmetric and positive definite, a row for each face
// whose velocity is to be found.
//
// Conjugate gradients in double, preconditioned by a V-cycle: sweeps of Gauss-Seidel over the rows
// forwards, rigid motions of blocks of cells (rigid_blocks.h), and as many backwards. Rows of one
// colour do not meet, so that sweeps are the same bits for any number of threads.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/gridfluid/viscosity/rigid_blocks.h"
#include "substep/gridfluid/viscosity/velocity_rows.h"

namespace substep::gridfluid {

struct ViscosityReport {
  int iterations = 0;
  bool converged = true, finite = true;
};

template <int D>
class VelocitySystem {
 public:
  VelocityRows<D> rows;

  // x from 0 on; stops where the energy of the error, x . A x of it, is about `goal`.
  ViscosityReport solve(std::span<const double> b, std::span<double> x, double goal,
                        int max_iterations, int threads);

 private:
  void precondition(int threads);
  void sweep(bool forwards, int threads);

  RigidBlocks<D> blocks_;
  std::vector<double> r_, z_, d_, q_;
};

extern template class VelocitySystem<2>;
extern template class VelocitySystem<3>;

}  // namespace substep::gridfluid
