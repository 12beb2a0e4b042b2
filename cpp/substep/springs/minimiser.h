// What a step of implicit Euler asks for: a point where the gradient of the energy is small.
#pragma once

#include <cmath>
#include <vector>

#include "substep/springs/incremental_potential.h"

namespace substep::springs {

struct MinimiserReport {
  bool converged = false;  // |g|_inf <= tolerance at x
  std::int64_t iterations = 0, factorizations = 0, backtracks = 0;
  std::int64_t refinements = 0;   // quasi-Newton steps, which need no factorization
  std::vector<double> residuals;  // |g|_inf [N] at the start and after each iteration
};

// |g|_inf; infinite where a component is NaN.
inline double largest_component(std::span<const Vec3> g) {
  double largest = 0.0;
  for (const Vec3& part : g) {
    const double size = part.cwiseAbs().maxCoeff<Eigen::PropagateNaN>();
    if (!(size <= largest)) largest = std::isnan(size) ? INFINITY : size;
  }
  return largest;
}

class Minimiser {
 public:
  virtual ~Minimiser() = default;

  // Moves x, at which nothing penetrates, to where no component of the gradient exceeds
  // `tolerance` [N]; without success x may be anywhere that the energy is finite.
  virtual MinimiserReport minimise(IncrementalPotential& energy, std::span<Vec3> x,
                                   double tolerance) = 0;
};

}  // namespace substep::springs
