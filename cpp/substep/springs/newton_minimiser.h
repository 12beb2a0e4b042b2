// Newton's method on the energy of a step (Nocedal and Wright, "Numerical Optimization", 2nd ed.,
// algorithm 3.2), with a sparse Cholesky factorization of a positive definite Hessian, steps that
// stop before anything penetrates, and backtracking until the energy falls.
#pragma once

#include <optional>

#include "substep/linalg/cholesky.h"
#include "substep/springs/minimiser.h"

namespace substep::springs {

class NewtonMinimiser : public Minimiser {
 public:
  explicit NewtonMinimiser(int max_iterations) : max_iterations_(max_iterations) {}
  MinimiserReport minimise(IncrementalPotential& energy, std::span<Vec3> x,
                           double tolerance) override;

 private:
  bool factor(std::span<const double> values);

  int max_iterations_;
  std::optional<Cholesky> cholesky_;  // of the pattern, which is that of every step
};

}  // namespace substep::springs
