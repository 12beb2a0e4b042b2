// What the passes do with the particles of one block and one material.
#pragma once

#include "substep/mpm/materials/materials.h"
#include "substep/mpm/passes/arena.h"

namespace substep::mpm {

template <class Real>
struct PassOptions {
  Real cell;     // dx [m]
  Real dt;       // of the step to which the nodes' velocities belong [s]
  Real next_dt;  // of the step for which particles scatter [s]
  Real before;   // dt of the step before dt's, whose return map is to come if `trial` [s]
  bool trial;
  bool rest;  // state and motion are at rest
  Real kept;  // AFLIP: the share that stays of what the grid does not see of v; below 0: APIC
};

// What AFLIP reads and sets besides: v^before, and momentum without the impulses of the stress.
template <class Real, int D>
struct BeforeImpulses {
  const Arena<Real, D>* from;
  Arena<Real, D>* to;
};

// Of all materials, in one translation unit for each precision and dimension.
template <class Real, int D>
struct Passes {
  using Group = ParticleGroup<Real, D>;
  using Walls = ParticleBoundary<Real, D>;

  static void p2g(const AnyMaterial& material, const Group& group, const Run& run,
                  const PassOptions<Real>& options, Arena<Real, D>& to,
                  const BeforeImpulses<Real, D>& before);
  static void g2p2g(const AnyMaterial& material, Group& group, const Run& run,
                    const PassOptions<Real>& options, std::int32_t block, Walls* walls,
                    const Arena<Real, D>& from, Arena<Real, D>& to,
                    const BeforeImpulses<Real, D>& before);
  static void g2p(const AnyMaterial& material, Group& group, const Run& run,
                  const PassOptions<Real>& options, std::int32_t block, Walls* walls,
                  const Arena<Real, D>& from, const BeforeImpulses<Real, D>& before);
};

}  // namespace substep::mpm
