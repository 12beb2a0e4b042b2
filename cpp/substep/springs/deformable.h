// A deformable body in time: vertices with masses, terms that pull on them (springs, tetrahedra),
// pins, colliders, and one of five integrators.
//
// The explicit ones take a(t, x, v) = g + (f - dW/dx - dD/dv) / m and return what went into a
// collider to its surface afterwards. Implicit Euler minimises the incremental potential, contact
// included; a step that does not converge is done again in halves, down to h / 2^max_halvings.
#pragma once

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "substep/springs/contact.h"
#include "substep/springs/incremental_potential.h"
#include "substep/springs/minimiser.h"
#include "substep/springs/spectrum.h"

namespace substep::springs {

enum class Integrator { explicit_euler, semi_implicit_euler, rk4, velocity_verlet, implicit_euler };

struct DeformableOptions {
  Integrator integrator = Integrator::implicit_euler;
  Vec3 gravity = {0.0, 0.0, -9.81};  // [m/s^2]
  double tolerance = 0.0;            // the largest component of the gradient that is left [N]
  int max_halvings = 8;
  int max_friction_iterations = 20;  // minimisations of one step, each with forces newly lagged
  double contact_stiffness = 0.0;    // k of contact.h for all vertices [N/m]; 0: m / h^2 each
  int threads = 0;
};

// What a step took, its halves together.
struct StepReport {
  bool converged = true;
  bool friction_converged = true;  // lagged forces agree with those found, within the tolerance
  std::int64_t iterations = 0, factorizations = 0, backtracks = 0, minimisations = 0;
  std::int64_t refinements = 0;   // quasi-Newton steps between the iterations
  std::int64_t failed = 0;        // steps that were done again in halves
  std::vector<double> residuals;  // |g|_inf [N] of the last minimisation
};

class Deformable {
 public:
  // All spans have one entry for each vertex. `minimiser` may be null for explicit integrators.
  Deformable(Positions positions, Positions velocities, std::span<const double> masses,
             std::span<const std::uint8_t> pinned, std::vector<std::shared_ptr<Term>> terms,
             Contacts contacts, std::unique_ptr<Minimiser> minimiser,
             const DeformableOptions& options);
  Deformable(const Deformable&) = delete;
  Deformable& operator=(const Deformable&) = delete;

  // One step of length h [s]; the external forces are then 0 again. An exception (NonFiniteError,
  // also where an explicit integrator diverges, ConvergenceError) leaves the body and its colliders
  // as they were.
  void step(double h);

  // To be read and written. Pinned vertices go to their targets in the next step, at constant
  // speed.
  std::vector<Vec3> positions, velocities, forces, targets;
  Contacts contacts;
  double time = 0.0;
  DeformableOptions options;

  std::int64_t vertices() const { return static_cast<std::int64_t>(positions.size()); }
  std::span<const double> masses() const { return potential_->masses(); }
  std::span<const std::uint8_t> pinned() const { return potential_->pinned(); }
  void set_pinned(std::span<const std::uint8_t> pinned);
  void set_threads(int threads);
  // The Hessian that a step of length h starts with, all negative curvature kept, as the values of
  // pattern(): for measurements and for analyses of modes.
  const BlockPattern& pattern() const { return potential_->pattern(); }
  void assemble(double h, std::span<double> values);
  const StepReport& report() const { return report_; }

  double kinetic_energy() const;
  double potential_energy() const;  // of all terms (contact too), without gravity
  Closest closest() const { return closest_vertex(contacts, positions); }
  Spectrum spectrum() const { return largest_eigenvalues(*potential_, positions); }

 private:
  void set_contact_stiffness(double h);
  Vec3 acceleration_without_terms(std::size_t i) const;
  void accelerations(Positions x, Positions v, std::span<Vec3> a);
  void explicit_step(double h);
  void implicit_steps(double h, int halvings);
  bool implicit_step(double h);
  void move_colliders(double h, std::vector<Vec3>& x);
  void start_ahead(double h, std::vector<Vec3>& x);
  void finish_bodies(double h, Positions x);
  bool minimise(std::span<Vec3> x);
  double residual(Positions x);  // |grad E|_inf [N]
  void check_finite(double h) const;
  void check_follows(double h, Positions v_before);
  [[noreturn]] void throw_not_finite(std::size_t i, double h) const;

  std::shared_ptr<BarrierTerm> barrier_;  // null without colliders, or an explicit integrator
  std::shared_ptr<FrictionTerm> friction_;
  std::unique_ptr<IncrementalPotential> potential_;
  std::unique_ptr<Minimiser> minimiser_;
  StepReport report_;
  // To an obstacle where the last implicit step set out from.
  Closest nearest_{std::numeric_limits<double>::infinity(), -1, -1};
  std::vector<Vec3> pin_velocities_;
  double accelerations_of_late_ = 0.0;  // the largest sum of m a^2 [N m/s^2], see check_follows
};

}  // namespace substep::springs
