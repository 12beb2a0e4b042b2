// Newton's method on the energy of a step (Nocedal and Wright, "Numerical Optimization", 2nd ed.,
// algorithm 3.2), with a sparse Cholesky factorization of the Hessian, steps that stop before
// anything penetrates, and backtracking until the energy falls. Where the Hessian is not positive
// definite (compressed springs), the factorization says so and less of its negative curvature is
// kept (Term::derivatives). A Hessian without any, the usual projection, converges slowly.
//
// Where a part of the curvature is left out, or a step had to be shortened, Newton's method is not
// yet quadratic, and another factorization brings little. Then quasi-Newton steps follow
// (limited_memory.h), whose first inverse Hessian is the last factorization: each costs a gradient
// and a solution, a sixth of a Newton step, and learns the curvature along the folds. They go on
// while the slope falls.
#pragma once

#include <memory>
#include <vector>

#include "substep/springs/bordered_cholesky.h"
#include "substep/springs/limited_memory.h"
#include "substep/springs/minimiser.h"

namespace substep::springs {

class NewtonMinimiser : public Minimiser {
 public:
  explicit NewtonMinimiser(int max_iterations);
  MinimiserReport minimise(IncrementalPotential& energy, std::span<Vec3> x,
                           double tolerance) override;

 private:
  void begin(IncrementalPotential& energy, Positions x);
  bool factorize(IncrementalPotential& energy, Positions x, MinimiserReport& report);
  double find_direction(const IncrementalPotential& energy, Positions x, bool learned);
  double descend(IncrementalPotential& energy, std::span<Vec3> x, double slope, int most_backtracks,
                 double least_part, MinimiserReport& report);
  void take_forces_as_they_are(IncrementalPotential& energy, Positions x);
  void refine(IncrementalPotential& energy, std::span<Vec3> x, double tolerance,
              MinimiserReport& report);

  int max_iterations_;
  std::unique_ptr<BorderedCholesky> cholesky_;  // of the pattern, which is that of every step
  std::vector<double> values_;
  double level_ = 0.0;  // the energy at x
  std::vector<Vec3> g_, dx_, trial_;
  std::vector<Vec3> x_before_, g_before_;
  LimitedMemory memory_;
  double kept_ = 1.0, next_kept_ = 1.0;
  int passed_ = 0;  // factorizations in a row that passed at the first try
};

}  // namespace substep::springs
