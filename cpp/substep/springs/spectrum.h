// The fastest motion of a body, which limits the step of every explicit integrator.
#pragma once

#include "substep/springs/incremental_potential.h"

namespace substep::springs {

struct Spectrum {
  double frequency;     // the largest omega, omega^2 an eigenvalue of M^-1 K at x [rad/s]
  double damping_rate;  // the largest eigenvalue of M^-1 C at x [1/s]
};

// By Lanczos' method from a fixed start; K without its negative curvature, so that it bounds.
Spectrum largest_eigenvalues(IncrementalPotential& potential, Positions x);

// That of a motion v of the free vertices, by Rayleigh's quotients v' K v / v' M v and
// v' C v / v' M v, which are at most the eigenvalues above.
Spectrum spectrum_of(IncrementalPotential& potential, Positions x, Positions v);

}  // namespace substep::springs
