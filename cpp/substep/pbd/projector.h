// Takes the place of the sweeps over all groups in an iteration: solvers that see a whole system at
// once, as against constraint by constraint.
#pragma once

#include <memory>
#include <span>

#include "substep/pbd/group.h"

namespace substep::pbd {

template <class Real>
class Projector {
 public:
  virtual ~Projector() = default;
  virtual std::unique_ptr<Projector> clone() const = 0;

  // Once, when all groups are attached. Groups that claimed() names are left to the projector; the
  // others are swept after it.
  virtual void attach(std::span<const std::unique_ptr<Group<Real>>> groups,
                      const Partition& partition) = 0;
  virtual bool claimed(std::size_t group) const = 0;
  virtual void begin_step(double /*h*/, int /*substeps*/, int /*iterations*/) {}
  // One iteration, on the calling thread outside of parallel loops. Returns how many constraints
  // were skipped because their gradients vanish.
  virtual std::int64_t project(const Sweep<Real>& s, int threads) = 0;
};

}  // namespace substep::pbd
