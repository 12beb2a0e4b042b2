// Velocity gradients at particles from velocities at nodes, and forces at nodes from stresses at
// particles: sums over a stencil of nodes of a particle with the same vectors g_i [1/cell],
//   H = sum_i v_i g_i^T,     f_i = A g_i,
// which are products of numbers per axis: g_i,a = g_a[k_a] prod_{b != a} w_b[k_b]. So the sums are
// carried out axis by axis. A node is a short vector of doubles.
#pragma once

#include "substep/core/lanes.h"
#include "substep/mpm/passes/options.h"
#include "substep/transfer/weights.h"

namespace substep::mpm {

template <int D>
inline constexpr int kNodeLanes = D == 2 ? 2 : 4;
template <int D>
using Node = Vector<double, 8 * kNodeLanes<D>>;

// w, g [1/cell] of order + 1 nodes along each axis; `first` in the arena.
template <int D>
struct ImplicitStencil {
  std::int32_t first;
  double w[D][4], g[D][4];
};

// x [cells from the first node of the arena]; MLS: g_i = D^-1 w (x_i - x_p); else the gradient of
// the spline.
template <int D, int kOrder>
ImplicitStencil<D> implicit_stencil(const double (&x)[D], Form form) {
  ImplicitStencil<D> s{};
  for (int d = 0; d < D; ++d) {
    const auto spline = transfer::spline<kOrder>(x[d]);
    s.first = s.first * transfer::kArena + spline.first;
    for (int k = 0; k <= kOrder; ++k) {
      s.w[d][k] = spline.w[k];
      s.g[d][k] = form == Form::kMls ? transfer::affine_weight(spline, k) : spline.g[k];
    }
  }
  return s;
}

// Column a of H in out[a].
template <int K>
SUBSTEP_INLINE void gather(const Node<3>* arena, const ImplicitStencil<3>& s, Node<3> (&out)[3]) {
  using N = Node<3>;
  const N* const at = arena + s.first;
  out[0] = out[1] = out[2] = N{};
#pragma GCC unroll 4
  for (int i = 0; i < K; ++i) {
    N u{}, uy{}, uz{};
#pragma GCC unroll 4
    for (int j = 0; j < K; ++j) {
      const N* const row = at + (i * transfer::kArena + j) * transfer::kArena;
      N v = s.w[2][0] * row[0], vz = s.g[2][0] * row[0];
#pragma GCC unroll 4
      for (int k = 1; k < K; ++k) {
        v = fma<N>(s.w[2][k], row[k], v);
        vz = fma<N>(s.g[2][k], row[k], vz);
      }
      u = fma<N>(s.w[1][j], v, u);
      uy = fma<N>(s.g[1][j], v, uy);
      uz = fma<N>(s.w[1][j], vz, uz);
    }
    out[0] = fma<N>(s.g[0][i], u, out[0]);
    out[1] = fma<N>(s.w[0][i], uy, out[1]);
    out[2] = fma<N>(s.w[0][i], uz, out[2]);
  }
}
template <int K>
SUBSTEP_INLINE void gather(const Node<2>* arena, const ImplicitStencil<2>& s, Node<2> (&out)[2]) {
  using N = Node<2>;
  const N* const at = arena + s.first;
  out[0] = out[1] = N{};
#pragma GCC unroll 4
  for (int i = 0; i < K; ++i) {
    const N* const row = at + i * transfer::kArena;
    N v = s.w[1][0] * row[0], vy = s.g[1][0] * row[0];
#pragma GCC unroll 4
    for (int j = 1; j < K; ++j) {
      v = fma<N>(s.w[1][j], row[j], v);
      vy = fma<N>(s.g[1][j], row[j], vy);
    }
    out[0] = fma<N>(s.g[0][i], v, out[0]);
    out[1] = fma<N>(s.w[0][i], vy, out[1]);
  }
}

// Adds A g_i, with column a of A in A[a].
template <int K>
SUBSTEP_INLINE void scatter(Node<3>* arena, const ImplicitStencil<3>& s, const Node<3> (&A)[3]) {
  using N = Node<3>;
  N* const at = arena + s.first;
#pragma GCC unroll 4
  for (int i = 0; i < K; ++i) {
    const N x = s.g[0][i] * A[0], y = s.w[0][i] * A[1], z = s.w[0][i] * A[2];
#pragma GCC unroll 4
    for (int j = 0; j < K; ++j) {
      N* const row = at + (i * transfer::kArena + j) * transfer::kArena;
      const N p = fma<N>(s.w[1][j], x, s.g[1][j] * y), q = s.w[1][j] * z;
#pragma GCC unroll 4
      for (int k = 0; k < K; ++k) {
        row[k] = fma<N>(s.w[2][k], p, fma<N>(s.g[2][k], q, row[k]));
      }
    }
  }
}
template <int K>
SUBSTEP_INLINE void scatter(Node<2>* arena, const ImplicitStencil<2>& s, const Node<2> (&A)[2]) {
  using N = Node<2>;
  N* const at = arena + s.first;
#pragma GCC unroll 4
  for (int i = 0; i < K; ++i) {
    const N x = s.g[0][i] * A[0], y = s.w[0][i] * A[1];
    N* const row = at + i * transfer::kArena;
#pragma GCC unroll 4
    for (int j = 0; j < K; ++j) {
      row[j] = fma<N>(s.w[1][j], x, fma<N>(s.g[1][j], y, row[j]));
    }
  }
}

// g_i of node (k_0, ..., k_D-1).
template <int D>
SUBSTEP_INLINE void node_gradient(const ImplicitStencil<D>& s, const int (&k)[D], double (&g)[D]) {
  for (int a = 0; a < D; ++a) {
    g[a] = s.g[a][k[a]];
    for (int b = 0; b < D; ++b) {
      if (b != a) g[a] *= s.w[b][k[b]];
    }
  }
}

}  // namespace substep::mpm
