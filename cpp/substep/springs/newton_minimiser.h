// Newton's method on the energy of a step (Nocedal and Wright, "Numerical Optimization", 2nd ed.,
// algorithm 3.2), with a sparse Cholesky factorization of the Hessian, steps that stop before
// anything penetrates, and backtracking until the energy falls. Where the Hessian is not positive
// definite (compressed springs), the factorization says so and less of its negative curvature is
// kept (Term::derivatives). A Hessian without any, the usual projection, converges slowly. Steps by
// a Hessian that lacks curvature are too short; they are doubled as long as the energy falls.
#pragma once

#include <memory>
#include <vector>

#include "substep/linalg/direct/supernodal_cholesky.h"
#include "substep/springs/minimiser.h"

namespace substep::springs {

class NewtonMinimiser : public Minimiser {
 public:
  explicit NewtonMinimiser(int max_iterations) : max_iterations_(max_iterations) {}
  MinimiserReport minimise(IncrementalPotential& energy, std::span<Vec3> x,
                           double tolerance) override;

 private:
  bool factorize(IncrementalPotential& energy, std::span<const Vec3> x, MinimiserReport& report);
  void accept(IncrementalPotential& energy, std::span<Vec3> x);

  int max_iterations_;
  std::unique_ptr<SupernodalCholesky> cholesky_;  // of the pattern, which is that of every step
  std::vector<double> values_;
  std::vector<Vec3> g_, dx_, trial_;
  double kept_ = 1.0, next_kept_ = 1.0;
};

}  // namespace substep::springs
