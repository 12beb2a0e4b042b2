// The passes of the fast path: quadratic B-splines, APIC velocities, forces by moving least
// squares. Particles of all materials share one grid.
//
// Hu et al., "A moving least squares material point method", 2018; G2P of a step fused with P2G of
// the next: Wang et al., "A massively parallel and scalable multi-GPU material point method", 2020.
//
// A run of steps is
//   p2g;  update the grid, check it          (a failure here leaves the particles as they were)
//   for each further step: [sort;] g2p2g; update the grid, check it
//   g2p
// All of it gives the same bits for any number of threads, and for g2p2g as for g2p and p2g.
//
// The caller sees to it that the sum of (greatest nodal speed) dt / dx over the steps since the
// last sort stays below drift_limit(2): weights are convex, so no particle is faster than the
// fastest node that it sees. sort comes between the update of the grid and g2p2g or g2p, when nodes
// hold velocities and particles need none; so a step that failed can always be reached again from
// the snapshot, whose first step is known to be good.
#pragma once

#include <functional>

#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

// Momentum (D) [kg m/s] and mass [kg] of each node after p2g and g2p2g; velocity [m/s] and mass
// when they are read.
template <class Real, int D>
using Nodes = transfer::NodeBlocks<Real, D>;

// For AFLIP nodes have a second layer, behind the first: the momentum without the impulses of the
// stress, which p2g and g2p2g set, and those that read nodes turn into v^before by the mass of the
// first.
template <class Real, int D>
std::int64_t layers_of(const Particles<Real, D>& particles) {
  return particles.flip_rate >= 0 ? 2 : 1;
}

// For AFLIP, before the first p2g of a run: what is at rest gives its v and spin to the state,
// where the passes take them from.
template <class Real, int D>
void carry_velocities(Particles<Real, D>& particles, int threads);

// Sets nodes (of particles.layout; sized here) from particles at rest, which do not change, for a
// step of dt [s].
template <class Real, int D>
void p2g(const Particles<Real, D>& particles, double dt, Nodes<Real, D>& nodes, int threads);

// Takes velocities, moves and deforms particles by dt, and scatters them for a step of next_dt. The
// first one after p2g puts the state aside in `other`: motion is lost, a snapshot kept.
template <class Real, int D>
void g2p2g(Particles<Real, D>& particles, double dt, double next_dt, const Nodes<Real, D>& from,
           Nodes<Real, D>& to, int threads);

// The last of a run: takes velocities, moves and deforms particles by dt, and leaves them at rest.
template <class Real, int D>
void g2p(Particles<Real, D>& particles, double dt, const Nodes<Real, D>& nodes, int threads);

// Sorts particles into blocks and cells, and carries nodes over to the new layout. Within a run
// (nodes hold velocities) motion is lost, and the snapshot becomes the state before the sort. The
// caller who will rewind keeps a copy of the sorted nodes. prepare(layout to come) is called before
// anything has changed; what it throws, or std::bad_alloc, leaves all as it was.
template <class Real, int D>
void sort(Particles<Real, D>& particles, Nodes<Real, D>& nodes, int threads,
          const std::function<void(const transfer::BlockLayout<D>&)>& prepare = {});

// The same for particles at rest, motion and all (and without nodes): for paths that read it.
template <class Real, int D>
void sort_at_rest(Particles<Real, D>& particles, int threads);

// Back to the snapshot, in the present order: the state from which the steps since the last sort,
// or since p2g, began. The nodes of that time are the caller's. Repeat at least one step, then g2p.
template <class Real, int D>
void rewind(Particles<Real, D>& particles, int threads);

}  // namespace substep::mpm
