// Weights of the quadratic spline for a packet of particles, and the sums over their 3^D nodes.
//
// With f the distance of a particle from its first node, in cells, the weights of the three nodes
// along an axis are (3/2 - f)^2 / 2, 3/4 - (f - 1)^2, (f - 1/2)^2 / 2, for 1/2 <= f < 3/2.
// What a node gets is affine in its place i: w_i (B + Q i), with Q as in transfers below.
#pragma once

#include "substep/mpm/passes/arena.h"
#include "substep/mpm/passes/node_lanes.h"

namespace substep::mpm {

template <class Real, int D>
struct alignas(64) Stencil {
  using V = Vector<Real>;
  static constexpr int kWidth = kLanes<Real>;
  using I = Vector<std::int32_t, kWidth * 4>;
  static constexpr int kReals = transfer::kNodeReals;

  V f[D];
  V w[D][3];
  Real last[kWidth][4];        // weights along the last axis, of each lane
  std::int32_t first[kWidth];  // of each lane: where in the arena its first node is

  SUBSTEP_INLINE explicit Stencil(const Real* x) {
    I node{};
    for (int d = 0; d < D; ++d) {
      const V at = load<V>(x + d * kWidth);
      I base = __builtin_convertvector(at - static_cast<Real>(0.5), I);
      base = base < 0 ? I{} : base;  // never: see drift_limit()
      base = base > 5 ? I{} + 5 : base;
      f[d] = at - __builtin_convertvector(base, V);
      const V a = static_cast<Real>(1.5) - f[d], b = f[d] - static_cast<Real>(1),
              c = f[d] - static_cast<Real>(0.5);
      w[d][0] = static_cast<Real>(0.5) * a * a;
      w[d][1] = static_cast<Real>(0.75) - b * b;
      w[d][2] = static_cast<Real>(0.5) * c * c;
      node = node * transfer::kArena + base;
    }
    node *= kReals;
    std::memcpy(first, &node, sizeof node);
    constexpr int kSide = kWidth < 4 ? kWidth : 4;
    for (int lane = 0; lane < kWidth; lane += kSide) {
      Quad<Real> q[4] = {};
      for (int k = 0; k < 3; ++k) {
        std::memcpy(&q[k], reinterpret_cast<const Real*>(&w[D - 1][k]) + lane,
                    kSide * sizeof(Real));
      }
      transpose4<Real>(q);
      for (int i = 0; i < kSide; ++i) std::memcpy(last[lane + i], &q[i], sizeof q[i]);
    }
  }

  // Of the nodes' numbers u: sums[c] = sum_i w_i u_c, sums[4 (1 + d) + c] = sum_i w_i i_d u_c.
  SUBSTEP_INLINE void gather(const Arena<Real, D>& arena, V (&sums)[16]) const {
    using R = Row<Real>;
    constexpr int kX = Arena<Real, D>::kRow * transfer::kArena, kY = Arena<Real, D>::kRow;
    const auto number = [](const V& v, int lane) {
      return reinterpret_cast<const Real*>(&v)[lane];
    };
    alignas(64) Real numbers[kWidth * 16];
    const R places = R::places();
    for (int l = 0; l < kWidth; ++l) {
      const Real* const p = arena.nodes + first[l];
      const R wz = R::spread(last[l]);
      const Real x0 = number(w[0][0], l), x1 = number(w[0][1], l), x2 = number(w[0][2], l);
      if constexpr (D == 3) {
        const Real y0 = number(w[1][0], l), y1 = number(w[1][1], l), y2 = number(w[1][2], l);
        R sum[3], moment[3];
        for (int i = 0; i < 3; ++i) {
          const R u2 = R::at(p + i * kX + 2 * kY), middle = y1 * R::at(p + i * kX + kY);
          const R top = multiply_add(y2, u2, middle);
          sum[i] = multiply_add(y0, R::at(p + i * kX), top);
          moment[i] = multiply_add(y2, u2, top);
        }
        const R middle = x1 * sum[1], top = multiply_add(x2, sum[2], middle);
        const R all = multiply_add(x0, sum[0], top) * wz;
        const R moment_x = multiply_add(x2, sum[2], top) * wz;
        const R moment_y =
            multiply_add(x2, moment[2], multiply_add(x1, moment[1], x0 * moment[0])) * wz;
        store_sums(all, moment_x, moment_y, all * places, numbers + 16 * l);
      } else {
        const R u2 = R::at(p + 2 * kY), top = multiply_add(x2, u2, x1 * R::at(p + kY));
        const R all = multiply_add(x0, R::at(p), top) * wz;
        store_sums(all, multiply_add(x2, u2, top) * wz, all * places, R::zero(), numbers + 16 * l);
      }
    }
    to_lanes<Real, D + 1>(numbers, reinterpret_cast<Real*>(sums));
  }

  // The mean divergence of u in the 2^D cells between the nodes [per cell], interpolated linearly
  // from their centres. Along an axis a cell is a difference of its own component and a mean of the
  // others.
  SUBSTEP_INLINE V divergence(const Arena<Real, D>& arena) const {
    using R = Row<Real>;
    constexpr int kX = Arena<Real, D>::kRow * transfer::kArena, kY = Arena<Real, D>::kRow;
    static constexpr Differences all;
    R weights[D - 1][2];  // of the lower and the upper node of a cell
    for (int d = 0; d < D - 1; ++d) {
      for (int k = 0; k < 2; ++k) weights[d][k] = R::repeated(all.of[d][k]);
    }
    const R first_cell = R::at(all.rows[0]), second_cell = R::at(all.rows[1]);
    const auto upper = [this](int d, int lane) {
      return reinterpret_cast<const Real*>(&f[d])[lane] - static_cast<Real>(0.5);
    };
    // Of three rows along axis d, whose second cell weighs t.
    const auto along = [&](int d, Real t, const R& u0, const R& u1, const R& u2) {
      const R low = multiply_add(1 - t, u0, t * u1), high = multiply_add(1 - t, u1, t * u2);
      return multiply_add(weights[d][1], high, weights[d][0] * low);
    };
    alignas(64) Real result[kWidth];
    for (int l = 0; l < kWidth; ++l) {
      const Real* const p = arena.nodes + first[l];
      const Real tx = upper(0, l), tz = upper(D - 1, l);
      R sum;
      if constexpr (D == 3) {
        const Real ty = upper(1, l);
        R slices[3];
        for (int i = 0; i < 3; ++i) {
          const Real* const q = p + i * kX;
          slices[i] = along(1, ty, R::at(q), R::at(q + kY), R::at(q + 2 * kY));
        }
        sum = along(0, tx, slices[0], slices[1], slices[2]);
      } else {
        sum = along(0, tx, R::at(p), R::at(p + kY), R::at(p + 2 * kY));
      }
      const auto parts =
          (sum * multiply_add(tz, second_cell, (1 - tz) * first_cell)).sum_over_nodes();
      result[l] = parts[0] + parts[1] + (D == 3 ? parts[2] : 0);
    }
    return load<V>(result);
  }

 private:
  // A cell's weights of the numbers of its lower and its upper node, by the axis; and along the
  // last axis those of a row's nodes, of its two cells.
  struct Differences {
    Real of[D][2][4] = {}, rows[2][16] = {};
    constexpr Differences() {
      for (int d = 0; d < D; ++d) {
        for (int c = 0; c < D; ++c) {
          of[d][0][c] = static_cast<Real>(c == d ? -1 : 0.5);
          of[d][1][c] = static_cast<Real>(c == d ? 1 : 0.5);
        }
      }
      for (int cell = 0; cell < 2; ++cell) {
        for (int k = 0; k < 8; ++k) rows[cell][4 * cell + k] = of[D - 1][k / 4][k % 4];
      }
    }
  };
};

// Adds w_i (B + Q i) to the nodes of particles one by one; those of one cell, which follow each
// other, are summed first.
template <class Real, int D>
class Scatter {
 public:
  using V = Vector<Real>;

  explicit SUBSTEP_INLINE Scatter(Arena<Real, D>& arena) : nodes_(arena.nodes) {}

  // affine[c] = B_c, affine[4 (1 + d) + c] = Q_cd, of the packet's first `count` lanes.
  SUBSTEP_INLINE void add(const Stencil<Real, D>& stencil, const V (&affine)[16], int count) {
    using R = Row<Real>;
    constexpr int kWidth = kLanes<Real>;
    alignas(64) Real numbers[kWidth * 16];
    from_lanes<Real, D + 1>(reinterpret_cast<const Real*>(affine), numbers);
    alignas(64) V weights[kRows];
    for (int r = 0; r < kRows; ++r) {
      weights[r] = D == 3 ? stencil.w[0][r / 3] * stencil.w[1][r % 3] : stencil.w[0][r];
    }
    const auto weight = [&](int r, int lane) {
      return reinterpret_cast<const Real*>(&weights[r])[lane];
    };
    const R places = R::places();
    for (int l = 0; l < count; ++l) {
      if (stencil.first[l] != first_) {
        flush();
        first_ = stencil.first[l];
      }
      const Real* const q = numbers + 16 * l;
      const R wz = R::spread(stencil.last[l]);
      const R qx = R::repeated(q + 4) * wz;
      R row = multiply_add(R::repeated(q + 4 * D), places, R::repeated(q)) * wz;
      if constexpr (D == 3) {
        const R qy = R::repeated(q + 8) * wz;
        for (int i = 0; i < 3; ++i) {
          R cell = row;
          for (int j = 0; j < 3; ++j) {
            sum_[3 * i + j] = multiply_add(weight(3 * i + j, l), cell, sum_[3 * i + j]);
            if (j < 2) cell = cell + qy;
          }
          if (i < 2) row = row + qx;
        }
      } else {
        for (int i = 0; i < 3; ++i) {
          sum_[i] = multiply_add(weight(i, l), row, sum_[i]);
          if (i < 2) row = row + qx;
        }
      }
    }
  }

  // To be called at the end.
  SUBSTEP_INLINE void flush() {
    if (first_ < 0) return;
    constexpr int kX = Arena<Real, D>::kRow * transfer::kArena, kY = Arena<Real, D>::kRow;
    for (int r = 0; r < kRows; ++r) {
      sum_[r].add_to(nodes_ + first_ + (D == 3 ? r / 3 * kX + r % 3 * kY : r * kY));
      sum_[r] = Row<Real>::zero();
    }
    first_ = -1;
  }

 private:
  static constexpr int kRows = D == 3 ? 9 : 3;
  Real* nodes_;
  Row<Real> sum_[kRows] = {};
  std::int32_t first_ = -1;
};

}  // namespace substep::mpm
