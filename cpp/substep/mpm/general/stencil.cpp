#include "substep/mpm/general/stencil.h"

#include "substep/transfer/weights.h"

namespace substep::mpm {

namespace {

template <class Real>
using NodeVector = Vector<Real, transfer::kNodeReals* static_cast<int>(sizeof(Real))>;

// Splines around a particle of an arena, whose node (i, j) has the number 8 i + j and node (i, j,
// k) the number 64 i + 8 j + k. Sums over its nodes are taken row by row: rows of nodes
// run along the last axis, where the weights of the axes before are the same.
template <class Real, int D, int kOrder>
struct Stencil {
  static constexpr int kLast = D - 1;
  transfer::Spline<Real, kOrder> axis[D];
  int first = 0;  // node of the arena

  SUBSTEP_INLINE Stencil(const Real* x, int lane) {
    for (int d = 0; d < D; ++d) {
      axis[d] = transfer::spline<kOrder>(x[d * kLanes<Real> + lane]);
      first = first * transfer::kArena + axis[d].first;
    }
  }
  // visit(first node of the row, the row's offsets along the axes before the last).
  template <class Visit>
  SUBSTEP_INLINE void for_rows(Visit&& visit) const {
    for (int i = 0; i <= kOrder; ++i) {
      if constexpr (D == 2) {
        visit(first + i * transfer::kArena, std::array<int, 1>{i});
      } else {
        for (int j = 0; j <= kOrder; ++j) {
          visit(first + (i * transfer::kArena + j) * transfer::kArena, std::array<int, 2>{i, j});
        }
      }
    }
  }
  SUBSTEP_INLINE Real weight(const std::array<int, kLast>& row) const {
    Real w = axis[0].w[row[0]];
    if constexpr (D == 3) w *= axis[1].w[row[1]];
    return w;
  }
  // The weight with `a` in the place of axis d.
  SUBSTEP_INLINE Real weight(const std::array<int, kLast>& row, int d, Real a) const {
    if constexpr (D == 3) a *= axis[1 - d].w[row[static_cast<unsigned>(1 - d)]];
    return a;
  }
};

template <class Real, int kRows>
SUBSTEP_INLINE NodeVector<Real> column(const Real (&rows)[kRows][kLanes<Real>], int lane) {
  NodeVector<Real> n{};
  for (int i = 0; i < kRows; ++i) n[i] = rows[i][lane];
  return n;
}
template <class Real, int D>
SUBSTEP_INLINE NodeVector<Real> column(const Real (&M)[D][D][kLanes<Real>], int j, int lane) {
  NodeVector<Real> n{};
  for (int i = 0; i < D; ++i) n[i] = M[i][j][lane];
  return n;
}

template <class Real, int D, int kOrder, bool kGradients>
void scatter(const Real* x, int count, const PacketMomenta<Real, D>& from, Arena<Real, D>& to) {
  using N = NodeVector<Real>;
  for (int lane = 0; lane < count; ++lane) {
    const Stencil<Real, D, kOrder> s(x, lane);
    // p + A r at the first node; from there r grows by the offset.
    N first = column<Real>(from.p, lane), A[D], T[D];
    for (int d = 0; d < D; ++d) {
      A[d] = column<Real, D>(from.A, d, lane);
      first -= A[d] * s.axis[d].distance;
      if constexpr (kGradients) T[d] = column<Real, D>(from.T, d, lane);
    }
    const auto& last = s.axis[s.kLast];
    s.for_rows([&](int node, const auto& row) {
      const Real w = s.weight(row);
      N constant = first;
      for (unsigned d = 0; d < s.kLast; ++d) constant += A[d] * Real(row[d]);
      constant *= w;
      const N linear = A[s.kLast] * w;
      N slope{};
      if constexpr (kGradients) {
        for (int d = 0; d < s.kLast; ++d) {
          constant += T[d] * s.weight(row, d, s.axis[d].g[row[static_cast<unsigned>(d)]]);
        }
        slope = T[s.kLast] * w;
      }
      for (int k = 0; k <= kOrder; ++k) {
        N n = (constant + linear * Real(k)) * last.w[k];
        if constexpr (kGradients) n += slope * last.g[k];
        Real* const sum = to.nodes + (node + k) * transfer::kNodeReals;
        n += load<N>(sum);
        std::memcpy(sum, &n, sizeof n);
      }
    });
  }
}

template <class Real, int D, int kOrder, bool kGradients>
void gather(const Real* x, int count, const Arena<Real, D>& from, PacketVelocities<Real, D>& to) {
  using N = NodeVector<Real>;
  for (int lane = 0; lane < count; ++lane) {
    const Stencil<Real, D, kOrder> s(x, lane);
    Real affine[D][kOrder + 1];
    for (int d = 0; d < D; ++d) {
      for (int k = 0; k <= kOrder; ++k) affine[d][k] = transfer::affine_weight(s.axis[d], k);
    }
    N v{}, C[D] = {}, G[D] = {};
    s.for_rows([&](int node, const auto& row) {
      N sum{}, along{}, slope{};
      for (int k = 0; k <= kOrder; ++k) {
        const N n = load<N>(from.nodes + (node + k) * transfer::kNodeReals);
        sum += n * s.axis[s.kLast].w[k];
        along += n * affine[s.kLast][k];
        if constexpr (kGradients) slope += n * s.axis[s.kLast].g[k];
      }
      const Real w = s.weight(row);
      v += sum * w;
      C[s.kLast] += along * w;
      if constexpr (kGradients) G[s.kLast] += slope * w;
      for (int d = 0; d < s.kLast; ++d) {
        const int k = row[static_cast<unsigned>(d)];
        C[d] += sum * s.weight(row, d, affine[d][k]);
        if constexpr (kGradients) G[d] += sum * s.weight(row, d, s.axis[d].g[k]);
      }
    });
    to.mass[lane] = v[D];
    for (int i = 0; i < D; ++i) {
      to.v[i][lane] = v[i];
      for (int d = 0; d < D; ++d) {
        to.C[i][d][lane] = C[d][i];
        if constexpr (kGradients) to.G[i][d][lane] = G[d][i];
      }
    }
  }
}

template <class Real, int D, int kOrder>
void scatter_values(const Real* x, int count, const PacketMomenta<Real, D>& from,
                    Arena<Real, D>& to) {
  using N = NodeVector<Real>;
  for (int lane = 0; lane < count; ++lane) {
    const Stencil<Real, D, kOrder> s(x, lane);
    const N p = column<Real>(from.p, lane);
    s.for_rows([&](int node, const auto& row) {
      const N of_row = p * s.weight(row);
      for (int k = 0; k <= kOrder; ++k) {
        Real* const sum = to.nodes + (node + k) * transfer::kNodeReals;
        const N n = load<N>(sum) + of_row * s.axis[s.kLast].w[k];
        std::memcpy(sum, &n, sizeof n);
      }
    });
  }
}

template <class Real, int D, int kOrder>
void gather_values(const Real* x, int count, const Arena<Real, D>& from,
                   PacketVelocities<Real, D>& to) {
  using N = NodeVector<Real>;
  for (int lane = 0; lane < count; ++lane) {
    const Stencil<Real, D, kOrder> s(x, lane);
    N v{};
    s.for_rows([&](int node, const auto& row) {
      N sum{};
      for (int k = 0; k <= kOrder; ++k) {
        sum += load<N>(from.nodes + (node + k) * transfer::kNodeReals) * s.axis[s.kLast].w[k];
      }
      v += sum * s.weight(row);
    });
    for (int i = 0; i < D; ++i) to.v[i][lane] = v[i];
  }
}

template <class Real, int D, int kOrder>
void divergence(const Real* x, int count, const Arena<Real, D>& from, Real* to) {
  using N = NodeVector<Real>;
  for (int lane = 0; lane < count; ++lane) {
    const Stencil<Real, D, kOrder> s(x, lane);
    // By axis and node: the difference of the axis' own component, the mean of the others.
    N along[D][kOrder + 1];
    for (int d = 0; d < D; ++d) {
      for (int k = 0; k <= kOrder; ++k) {
        along[d][k] = N{} + transfer::corner_weight(s.axis[d], k);
        along[d][k][d] = s.axis[d].g[k];
      }
    }
    N sum{};
    s.for_rows([&](int node, const auto& row) {
      N of_row{};
      for (int k = 0; k <= kOrder; ++k) {
        of_row += load<N>(from.nodes + (node + k) * transfer::kNodeReals) * along[s.kLast][k];
      }
      for (unsigned d = 0; d < s.kLast; ++d) of_row *= along[d][row[d]];
      sum += of_row;
    });
    to[lane] = 0;
    for (int d = 0; d < D; ++d) to[lane] += sum[d];
  }
}

template <class Real, int D, int kOrder, bool kT, bool kG>
constexpr Stencils<Real, D> kStencils{scatter<Real, D, kOrder, kT>, gather<Real, D, kOrder, kG>,
                                      scatter_values<Real, D, kOrder>,
                                      gather_values<Real, D, kOrder>, divergence<Real, D, kOrder>};

}  // namespace

template <class Real, int D>
Stencils<Real, D> stencils(int order, bool gradients) {
  if (order == 1) return kStencils<Real, D, 1, true, false>;
  if (order == 2) {
    return gradients ? kStencils<Real, D, 2, true, true> : kStencils<Real, D, 2, false, false>;
  }
  return gradients ? kStencils<Real, D, 3, true, true> : kStencils<Real, D, 3, false, false>;
}

template Stencils<float, 2> stencils(int, bool);
template Stencils<float, 3> stencils(int, bool);
template Stencils<double, 2> stencils(int, bool);
template Stencils<double, 3> stencils(int, bool);

}  // namespace substep::mpm
