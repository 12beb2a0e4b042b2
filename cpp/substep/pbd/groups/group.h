// Constraints of one kind: what the solver sweeps over. ConstraintGroup (constraint_group.h) makes
// one of any struct of formulas (constraint.h); constraints that do not fit such a struct (clusters
// of many particles, functions of the user, contacts that come and go) derive from Group
// themselves.
//
// Calls are virtual per patch or phase, never per constraint. The solver stores particles patch by
// patch (partition.h). In every iteration project_patch() runs for all patches at once, in which a
// group projects what joins particles of that patch only; then the phases of each group run one
// after the other for the rest, where the chunks of one phase share no particle.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "substep/core/point.h"
#include "substep/pbd/groups/partition.h"

namespace substep::pbd {

// How hard constraints are: each list has one number for all or one for each.
struct Softness {
  bool physical = true;            // XPBD; else plain PBD
  std::vector<double> compliance;  // alpha, at least 0; the inverse of a stiffness
  std::vector<double> damping;     // beta, at least 0
  std::vector<double> stiffness;   // k of plain PBD, 0 to 1
};

// What a projection works on.
template <class Real>
struct Sweep {
  Point<Real>* x;              // positions; w: inverse mass, 0 where pinned; row `count` is empty
  const Point<Real>* x_old;    // those at the start of the substep
  const std::int32_t* splits;  // how many constraints hold each particle; Jacobi only
  std::int64_t count;          // particles
  double h;                    // substep [s]
  int substep, substeps;       // which of how many
  int iteration, iterations;   // which of how many, in this substep
  double relaxation;           // of Jacobi
  bool last_substep() const { return substep + 1 == substeps; }
};

template <class Real>
class Group {
 public:
  virtual ~Group() = default;
  virtual std::unique_ptr<Group> clone() const = 0;

  // Constraints.
  virtual std::int64_t size() const = 0;
  // The storage order of the particles: called once, before anything else. Indices that the group
  // was made with are those of the user: slot[index] is the row of Sweep::x.
  virtual void attach(const Partition& partition) = 0;

  // Once per step, on the calling thread: throw InputError or SolverError here to refuse it.
  virtual void begin_step(double /*h*/, int /*substeps*/, int /*iterations*/) {}
  // The step is done, or it failed: then what the group remembers is as before begin_step().
  virtual void end_step(bool /*done*/) {}
  // Where prepares(): once per substep, on the calling thread outside of parallel loops, at the
  // predicted positions (new contacts).
  virtual bool prepares() const { return false; }
  virtual void prepare(const Sweep<Real>&, int /*threads*/) {}
  // The same after the last iteration and the colliders: has the last word on where particles go.
  virtual void complete(const Sweep<Real>&, int /*threads*/) {}

  // Gauss-Seidel. Each returns how many constraints were skipped because their gradients vanish.
  virtual std::int64_t project_patch(std::int64_t /*patch*/, const Sweep<Real>&) { return 0; }
  virtual int phases() const { return 0; }
  virtual std::int64_t chunks(int /*phase*/) const { return 0; }
  virtual std::int64_t project(int /*phase*/, std::int64_t /*chunk*/, const Sweep<Real>&) {
    return 0;
  }
  // Whether project() must be called on the calling thread, outside of parallel loops (Python).
  virtual bool serial() const { return false; }

  // Jacobi: corrections are evaluated at the same positions, one row for each particle of each
  // constraint, and the solver adds up those of a particle in the order of the rows. holders()[row]
  // is the particle (a slot, or -1: no one's). Groups without rows are swept after that.
  virtual std::vector<std::int32_t> holders() const { return {}; }
  virtual std::int64_t correction_chunks() const { return 0; }
  virtual std::int64_t correct(std::int64_t /*chunk*/, const Sweep<Real>&, Point<Real>* /*rows*/) {
    return 0;
  }

  // For diagnostics, in the order that the group was made with: C of each constraint at the present
  // positions, and lambda of the last substep (what the constraint pulled with is lambda / h^2).
  virtual void values(const Sweep<Real>&, std::span<double> /*c*/) const {}
  virtual void multipliers(std::span<double> /*lambda*/) const {}
  // Elastic energy [J] of what has a compliance: C^2 / (2 alpha).
  virtual double energy(const Sweep<Real>&) const { return 0; }

  // What a group remembers from one step to the next, for checkpoints.
  virtual std::vector<double> state() const { return {}; }
  virtual void restore(std::span<const double>) {}
};

}  // namespace substep::pbd
