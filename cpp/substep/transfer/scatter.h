// A vector per particle, spread over the nodes of sparse blocks that its spline reaches.
#pragma once

#include "substep/core/usize.h"
#include "substep/transfer/weights.h"

namespace substep::transfer {

// Adds w_i s a to the first D numbers of every node i that a particle reaches by a spline of
// kOrder. x is in cells from the first node of the arena, whose node blocks are `corners`
// (BlockLayout::arenas).
template <int kOrder, class Real, int D>
void scatter(const std::array<double, D>& x, const std::array<double, D>& a, double s,
             const std::array<std::int32_t, (1 << D)>& corners, NodeBlocks<Real, D>& to) {
  const Weights<double, kOrder, D> stencil = weights<Collocated, kOrder>(x, 0);
  for (int n = 0; n < stencil.kNodes; ++n) {
    const auto k = stencil.offsets(n);
    double w = stencil.axis[0].w[k[0]] * stencil.axis[1].w[k[1]] * s;
    if constexpr (D == 3) w *= stencil.axis[2].w[k[2]];
    std::size_t corner = 0, node = 0;
    for (const std::int32_t i : stencil.node(k)) {
      corner = corner * 2 + usize(i / kBlock);
      node = node * kBlock + usize(i % kBlock);
    }
    Real* const sum = to.block(corners[corner]) + node * kNodeReals;
    for (std::size_t d = 0; d < D; ++d) sum[d] += static_cast<Real>(w * a[d]);
  }
}

// The same for an order that is known only now.
template <class Real, int D>
void scatter(int order, const std::array<double, D>& x, const std::array<double, D>& a, double s,
             const std::array<std::int32_t, (1 << D)>& corners, NodeBlocks<Real, D>& to) {
  if (order == 1) return scatter<1, Real, D>(x, a, s, corners, to);
  if (order == 2) return scatter<2, Real, D>(x, a, s, corners, to);
  return scatter<3, Real, D>(x, a, s, corners, to);
}

}  // namespace substep::transfer
