// A step of implicit (backward) Euler on the grid.
//
// The velocities v of the nodes at the end of the step solve
//   m_i (v_i - v_i^n - dt g) + dPsi/dv_i = dt (contact forces),
// which is where, for elastic materials, the incremental potential
//   E(v) = sum_i m_i/2 |v_i - v_i^n - dt g|^2 + Psi(v)
// is least among the velocities that the obstacles allow (Gast, Schroeder, Stomakhin, Jiang, Teran,
// "Optimization integrator for large time steps", IEEE TVCG 21 (2015) 1103, eq. 5 and section 6;
// the linearised form is Stomakhin et al., "A material point method for snow simulation", 2013,
// section 5). Newton's method with a line search, whose linear systems are solved by conjugate
// gradients, preconditioned by the diagonal D x D blocks. A direction of negative curvature ends
// conjugate gradients with the direction found so far (Nocedal, Wright, "Numerical Optimization",
// 2nd ed., algorithm 7.1), so that the Hessian needs no projection.
//
// Materials with viscosity or plastic flow have no such potential: their stress, after the return
// map of the trial state, is inside the equation, whose root is found with BiCGSTAB on the
// unsymmetric derivative and a line search on the residual. So the stress that acts is always
// admissible (a lagged return map lets sand resist tension for the length of a step).
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/implicit/contacts.h"
#include "substep/mpm/implicit/particles.h"

namespace substep::mpm {

struct ImplicitOptions {
  // Of the residual r: sqrt(sum |r_i|^2 / m_i / sum m_i) [m/s] is at most this times the scale
  // max(|g| dt, rms velocity of the nodes): the share of the velocity change by gravity (or of the
  // motion) in one step that stays unexplained.
  double tolerance = 1e-3;
  double slip = 1e-2;     // of the same scale: the speed below which friction holds
  int max_newton = 50;    // iterations of one solve
  int max_krylov = 2000;  // iterations of one linear system
  int max_rounds = 12;    // of contact states
};

// Of one step.
struct ImplicitReport {
  bool converged = false;  // Newton's method reached the tolerance
  bool settled = false;    // the states of the contacts are consistent too
  std::int64_t newton = 0, krylov = 0, halvings = 0, rounds = 0;
  std::int64_t indefinite = 0;    // linear systems with a direction of negative curvature
  double scale = 0;               // of the tolerance [m/s]
  std::vector<double> residuals;  // before and after each iteration, 1: the tolerance
  std::string remedy;             // where it did not converge
};

template <class Real, int D>
class ImplicitStep {
 public:
  explicit ImplicitStep(double cell, const ImplicitOptions& options = {})
      : options_(options), distances_(cell, 0) {}

  // nodes: momentum and mass as p2g(particles, 0, ...) leaves them. Where the report says
  // converged, they hold the momentum at the end of a step of dt, gravity and obstacles included;
  // else they are as they were.
  const ImplicitReport& solve(const Particles<Real, D>& particles, std::span<Real> nodes, double dt,
                              const geometry::Vec3& gravity, int order, Form form,
                              std::span<const geometry::Collider> colliders,
                              std::span<const Boundary> boundaries, int threads);
  const ImplicitReport& report() const { return report_; }

  // What the last solve gave to each collider.
  const std::vector<geometry::Exchange>& exchanges() const { return exchanges_; }

 private:
  struct Problem;
  bool solve_rounds(Problem& problem, std::span<double> v);

  ImplicitOptions options_;
  NodeDistances<Real, D> distances_;
  ImplicitNodes<D> nodes_;
  ImplicitParticles<D> particles_;
  ImplicitContacts<D> contacts_;
  ImplicitReport report_;
  std::vector<geometry::Exchange> exchanges_;
};

}  // namespace substep::mpm
