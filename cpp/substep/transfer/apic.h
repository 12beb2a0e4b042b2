// Affine particle-in-cell on any regular grid: collocated, or staggered (marker-and-cell), where
// each component of the velocity has nodes, weights and an affine row of its own.
//
// Jiang, Schroeder, Selle, Teran, Stomakhin, "The affine particle-in-cell method", 2015; Jiang,
// Schroeder, Teran, "An angular momentum conserving affine-particle-in-cell method", 2017. Row c of
// C is D_c^-1 sum_i w_ci v_ci (x_ci - x_p), with D_c of weights.h. A velocity that is linear in x
// passes to the grid and back unchanged; either way momentum and angular momentum, sum_p m (x_p x
// v_p) and that of the affine part m eps : (C D), are conserved.
//
// A grid is whatever an accessor says: node(c, index) gives a reference to what stands at a node of
// component c, dense or sparse.
#pragma once

#include "substep/transfer/weights.h"

namespace substep::transfer {

// Motion of a particle: v [m/s], C = grad v [1/s]; x is in cells, dx [m] a cell.
template <class Real, int D>
struct AffineMotion {
  std::array<Real, D> v{};
  std::array<std::array<Real, D>, D> C{};
};

// What a node of one component receives: momentum [kg m/s] and mass [kg].
template <class Real>
struct NodeSum {
  Real momentum = 0, mass = 0;
};

// Adds m w and m w (v + C (x_i - x_p)) to the nodes.
template <class Grid, int kOrder, class Real, std::size_t D, class Nodes>
void particle_to_grid(const std::array<Real, D>& x, Real mass,
                      const AffineMotion<Real, static_cast<int>(D)>& motion, Real dx,
                      Nodes&& node) {
  for (std::size_t c = 0; c < D; ++c) {
    const auto stencil = weights<Grid, kOrder>(x, static_cast<int>(c));
    for (int n = 0; n < stencil.kNodes; ++n) {
      const auto k = stencil.offsets(n);
      const auto r = stencil.arm(k);
      Real v = motion.v[c];
      for (std::size_t d = 0; d < D; ++d) v += motion.C[c][d] * (dx * r[d]);
      const Real m = mass * stencil.weight(k);
      NodeSum<Real>& sum = node(static_cast<int>(c), stencil.node(k));
      sum.momentum += m * v;
      sum.mass += m;
    }
  }
}

// v = sum w v_i and C = D^-1 sum w v_i (x_i - x_p) from velocities at the nodes.
template <class Grid, int kOrder, class Real, std::size_t D, class Nodes>
AffineMotion<Real, static_cast<int>(D)> grid_to_particle(const std::array<Real, D>& x, Real dx,
                                                         Nodes&& velocity) {
  AffineMotion<Real, static_cast<int>(D)> motion;
  for (std::size_t c = 0; c < D; ++c) {
    const auto stencil = weights<Grid, kOrder>(x, static_cast<int>(c));
    for (int n = 0; n < stencil.kNodes; ++n) {
      const auto k = stencil.offsets(n);
      const auto a = stencil.affine(k);
      const Real v = velocity(static_cast<int>(c), stencil.node(k));
      motion.v[c] += stencil.weight(k) * v;
      for (std::size_t d = 0; d < D; ++d) motion.C[c][d] += a[d] / dx * v;
    }
  }
  return motion;
}

}  // namespace substep::transfer
