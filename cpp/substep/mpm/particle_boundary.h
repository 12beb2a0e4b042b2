// Keeps particles out of obstacles at the end of a step, where the grid's condition alone did not:
// between nodes, at walls thinner than a cell, at corners, before fast ones.
//
// A particle that was free goes from where it was to where the grid moves it, in the frame of each
// collider, which moves and turns meanwhile, and ends at least `margin` outside
// (geometry/conservative_advancement.h). Where that took anything away, its velocity takes the
// collider's condition (boundary.h) at once, and the impulse m dv is the collider's. A particle
// that was inside already, as where a collider was put upon it, is pushed out by up to kPush cells
// a step, without an impulse.
//
// Only particle blocks that a collider comes near to are looked at (near()), and there only packets
// whose lower bound of the distance does not clear them.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/geometry/collider.h"
#include "substep/mpm/boundary.h"
#include "substep/mpm/particles.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

template <class Real, int D>
class ParticleBoundary {
 public:
  static constexpr double kMargin = 1e-3;  // cells that particles keep from a surface
  static constexpr double kPush = 0.02;    // cells

  // Whether particles of particle block b may touch a collider in this step.
  bool near(std::int32_t block) const {
    return !slots_.empty() && slots_[static_cast<std::size_t>(block)] >= 0;
  }

  // One packet of a near block, after its velocity v is gathered and x advanced, both of which may
  // change: number d of lane l at [d * kLanes<Real> + l], x in cells from the arena's first node.
  // `before`: x before the step. volume: V_0 of each lane, density: rho_0. Lanes from `count` on
  // repeat the last particle: they move with it and exchange nothing. C and F stay as they are.
  // Safe from tasks that each have blocks of their own.
  void settle(std::int32_t block, const Real* before, Real* x, Real* v, const Real* volume,
              double density, int count);

 private:
  std::vector<std::int32_t> slots_;  // of each particle block: which near block it is, or -1
};

}  // namespace substep::mpm
