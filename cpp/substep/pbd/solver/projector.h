// Comes before the sweeps over all groups in an iteration: what sees a whole system at once, as
// against constraint by constraint.
#pragma once

#include <memory>

#include "substep/pbd/groups/group.h"

namespace substep::pbd {

template <class Real>
class Projector {
 public:
  virtual ~Projector() = default;
  virtual std::unique_ptr<Projector> clone() const = 0;

  // Once. The groups are swept after the projector.
  virtual void attach(const Partition& partition) = 0;
  virtual void begin_step(double /*h*/, int /*substeps*/, int /*iterations*/) {}
  // One iteration, on the calling thread outside of parallel loops. Returns how many constraints
  // were skipped because their gradients vanish.
  virtual std::int64_t project(const Sweep<Real>& s, int threads) = 0;
};

}  // namespace substep::pbd
