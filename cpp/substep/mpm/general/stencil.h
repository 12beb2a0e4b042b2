// What the particles of a packet give to the nodes of their arena, and take from them: four numbers
// of a node (momentum or velocity, then mass) at a time.
#pragma once

#include "substep/mpm/passes/arena.h"

namespace substep::mpm {

// Of each lane: a node receives w (p + A r) + T grad w, where r is the arm and grad w the gradient,
// both in cells, and p ends with the mass.
template <class Real, int D>
struct PacketMomenta {
  alignas(64) Real p[D + 1][kLanes<Real>];
  alignas(64) Real A[D][D][kLanes<Real>];
  alignas(64) Real T[D][D][kLanes<Real>];
};

// Of each lane: sum w n_i, sum D^-1 w n_i r^T and sum n_i grad w^T [per cell] of the numbers n_i of
// the nodes.
template <class Real, int D>
struct PacketVelocities {
  alignas(64) Real v[D][kLanes<Real>];
  alignas(64) Real C[D][D][kLanes<Real>];
  alignas(64) Real G[D][D][kLanes<Real>];
  alignas(64) Real mass[kLanes<Real>];  // in a cell around
};

// For one order of the spline, with T and G or without (order 1 always has T, and never G: its C is
// the same). x as in the packet; the first `count` lanes are particles.
template <class Real, int D>
struct Stencils {
  using Momenta = PacketMomenta<Real, D>;
  using Velocities = PacketVelocities<Real, D>;
  void (*scatter)(const Real* x, int count, const Momenta& from, Arena<Real, D>& to);
  void (*gather)(const Real* x, int count, const Arena<Real, D>& from, Velocities& to);
  // The same for p and v alone.
  void (*scatter_values)(const Real* x, int count, const Momenta& from, Arena<Real, D>& to);
  void (*gather_values)(const Real* x, int count, const Arena<Real, D>& from, Velocities& to);
  // Of each lane: the divergence [per cell] of the cells between the nodes, each a mean over its
  // corners, interpolated by the spline of one order less.
  void (*divergence)(const Real* x, int count, const Arena<Real, D>& from, Real* to);
};
template <class Real, int D>
Stencils<Real, D> stencils(int order, bool gradients);

}  // namespace substep::mpm
