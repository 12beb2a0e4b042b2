// Projective dynamics (Bouaziz et al., SIGGRAPH 2014; for springs Liu et al., "Fast simulation of
// mass-spring systems", SIGGRAPH Asia 2013): a fixed number of local and global steps. The local
// step turns each spring to its rest length where it is, the global one solves
//   (M / h^2 + L) x = M y / h^2 + sum k r u,   L the Laplacian of the springs with weights k,
// which is x <- x - (M / h^2 + L)^-1 grad E(x). As k I bounds the Hessian of a spring, the energy
// falls in every step. The matrix is constant, and factorized once for each h and set of pins.
//
// It is cheap and does not converge: the result depends on the number of iterations and looks
// softer and more damped than the minimum. report.converged only says that they were done.
#pragma once

#include <memory>
#include <vector>

#include "substep/linalg/direct/supernodal_cholesky.h"
#include "substep/springs/minimiser.h"

namespace substep::springs {

class ProjectiveMinimiser : public Minimiser {
 public:
  explicit ProjectiveMinimiser(int iterations) : iterations_(iterations) {}
  // Throws InputError if a term has no curvature_bound().
  MinimiserReport minimise(IncrementalPotential& energy, std::span<Vec3> x,
                           double tolerance) override;

 private:
  void factorize(const IncrementalPotential& energy);

  int iterations_;
  double h_ = 0.0;  // of the factor
  std::vector<std::uint8_t> pinned_;
  SparsePattern lower_;
  std::unique_ptr<SupernodalCholesky<>> cholesky_;
  std::vector<Vec3> g_;
};

}  // namespace substep::springs
