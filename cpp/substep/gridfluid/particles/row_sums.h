// What the particles of a row of cells add to the nodes around it, with trilinear weights.
//
// Along an axis where nodes are at half-integers a particle reaches the lower two or the upper two
// of three nodes, depending on the half of the cell that it is in: so the 2^D nodes of a particle
// are one of few sets for its cell (its quadrant). Each has sums of its own, a vector of 2^D lanes:
// adding a particle is one multiplication and addition of vectors. After the last particle of a
// row, its sums are added to the rows of the grid.
//
// Bit d of a lane says which of the two nodes along axis d it is. Bit b of a quadrant says which
// half along the b-th of the axes with nodes at half-integers (which are all but the component).
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "substep/core/aligned_buffer.h"
#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// kShifts: axes with nodes at half-integers (D - 1 for faces, D for centres). kSums: of each node.
template <class Real, int D, int kShifts, int kSums>
class RowSums {
 public:
  static constexpr int kNodes = 1 << D;
  static constexpr int kQuadrants = 1 << kShifts;
  static constexpr int kQuadrant = kSums * kNodes;      // numbers
  static constexpr int kCell = kQuadrants * kQuadrant;  // numbers

  // The bit of a quadrant that stands for an axis.
  static constexpr int shift_bit(int component, int axis) {
    return component != kCentres && axis > component ? axis - 1 : axis;
  }

  void reset(int component, int row_length) {
    component_ = component;
    numbers_.reset(usize((row_length + 2 * kMargin) * kCell));
    std::fill(numbers_.begin(), numbers_.end(), Real(0));
    nodes_.reset(usize((row_length + 2 * kMargin) * kRows));
  }

  // Sums of cell 0, quadrant 0; those of cell k, quadrant q follow kCell k + kQuadrant q further.
  // Of each quadrant: kNodes of the first sum, then of the second.
  Real* data() { return numbers_.data() + kMargin * kCell; }

  // Adds the sums of cells k0 to k1 of the row whose cell 0 has this index to the grid, and clears
  // them.
  void add_to(const Layout<D>& layout, std::int64_t row, int k0, int k1,
              const std::array<Real*, kSums>& grid) {
    constexpr bool kHalf = kShifts == D;
    const bool shifted = kHalf || component_ != D - 1;  // nodes at half-integers along the row
    const int crosses = 1 << (shifted ? kShifts - 1 : kShifts);
    const int begin = shifted ? k0 - 1 : k0, count = k1 + 2 - begin;
    for (int cross = 0; cross < crosses; ++cross) {
      std::array<std::int64_t, kRows> rows;
      for (int m = 0; m < kRows; ++m) rows[usize(m)] = row + begin + offset(layout, cross, m);
      for (int s = 0; s < kSums; ++s) {
        const Real* const lower = data() + cross * kQuadrant + s * kNodes;
        if (shifted) {
          join_shifted(lower, lower + crosses * kQuadrant, begin, count);
        } else {
          join(lower, begin, count);
        }
        add_rows(rows, count, grid[usize(s)]);
      }
    }
    std::fill(data() + k0 * kCell, data() + (k1 + 1) * kCell, Real(0));
  }

 private:
  static constexpr int kMargin = 2;         // cells of zeros before and after the row
  static constexpr int kRows = kNodes / 2;  // rows of nodes that a quadrant touches
  using Half = Vector<Real, kRows* static_cast<int>(sizeof(Real))>;

  // From the row of cells to row m of a quadrant's nodes.
  std::int64_t offset(const Layout<D>& layout, int cross, int m) const {
    std::int64_t sum = 0;
    for (int d = 0; d < D - 1; ++d) {
      const int lowest = d == component_ ? 0 : (cross >> shift_bit(component_, d) & 1) - 1;
      sum += (lowest + (m >> d & 1)) * layout.stride[usize(d)];
    }
    return sum;
  }

  // Nodes begin, begin + 1, ... along the row, from the halves of the sums of the cells around.
  void join(const Real* sums, int begin, int count) {
    for (int k = 0; k < count; ++k) {
      const Real* const here = sums + (begin + k) * kCell;
      const Half node = load<Half>(here) + load<Half>(here - kCell + kRows);
      std::memcpy(nodes_.data() + k * kRows, &node, sizeof node);
    }
  }
  void join_shifted(const Real* lower, const Real* upper, int begin, int count) {
    for (int k = 0; k < count; ++k) {
      const std::int64_t here = (begin + k) * kCell;
      const Half node =
          (load<Half>(upper + here - kCell + kRows) + load<Half>(lower + here + kRows)) +
          (load<Half>(upper + here) + load<Half>(lower + here + kCell));
      std::memcpy(nodes_.data() + k * kRows, &node, sizeof node);
    }
  }

  void add_rows(const std::array<std::int64_t, kRows>& rows, int count, Real* grid) const {
    const Real* const __restrict from = nodes_.data();
    Real* const __restrict r0 = grid + rows[0];
    Real* const __restrict r1 = grid + rows[1];
    if constexpr (D == 2) {
      for (int k = 0; k < count; ++k) {
        r0[k] += from[2 * k];
        r1[k] += from[2 * k + 1];
      }
    } else {
      Real* const __restrict r2 = grid + rows[2];
      Real* const __restrict r3 = grid + rows[3];
      for (int k = 0; k < count; ++k) {
        r0[k] += from[4 * k];
        r1[k] += from[4 * k + 1];
        r2[k] += from[4 * k + 2];
        r3[k] += from[4 * k + 3];
      }
    }
  }

  int component_ = 0;
  AlignedBuffer<Real> numbers_, nodes_;
};

// What a particle adds with, for as many particles as fit the L1 cache: by axis, the fraction of
// the way from the lower to the upper node, where nodes are at integers (f) and at half-integers
// (h).
template <class Real, int D>
struct RowWeights {
  static constexpr int kParticles = 64;
  template <class T>
  using Numbers = std::array<T, kParticles>;
  alignas(64) std::array<Numbers<Real>, D> f, h;
  std::array<Numbers<IntOf<Real>>, D> upper;  // 1 in the upper half of the cell
  Numbers<IntOf<Real>> cell;                  // along the row

  // Of `count` particles from `begin` on, whose cells are (cross, k); reads whole vectors.
  void set(const std::array<const Real*, D>& x, std::int64_t begin, int count,
           const std::array<int, D - 1>& cross, int row_length) {
    using V = Vector<Real>;
    using I = Vector<IntOf<Real>>;
    constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));
    const V last = splat<V>(static_cast<Real>(row_length - 1));
    for (int p = 0; p < count; p += kLanes) {
      for (std::size_t d = 0; d < D; ++d) {
        const V at = load<V>(x[d] + begin + p);
        V low;
        if (d < D - 1) {
          low = splat<V>(static_cast<Real>(cross[std::min(d, usize(D - 2))]));
        } else {
          const V above = at > 0 ? at : V{};
          const I k = __builtin_convertvector(above < last ? above : last, I);
          low = __builtin_convertvector(k, V);
          std::memcpy(&cell[usize(p)], &k, sizeof k);
        }
        const V own = at - low;
        const I half = own >= Real(0.5);
        const V shifted = half ? own - Real(0.5) : own + Real(0.5);
        const I bit = half & 1;
        std::memcpy(&f[d][usize(p)], &own, sizeof own);
        std::memcpy(&h[d][usize(p)], &shifted, sizeof shifted);
        std::memcpy(&upper[d][usize(p)], &bit, sizeof bit);
      }
    }
  }
};

// The lanes of a particle's nodes: in one vector, or in parts where vectors are shorter.
template <class Real, int D>
struct NodeLanes {
  static constexpr int kBytes = std::min(kVectorBytes, (1 << D) * static_cast<int>(sizeof(Real)));
  using V = Vector<Real, kBytes>;
  static constexpr int kLanes = kBytes / static_cast<int>(sizeof(Real));
  static constexpr int kParts = (1 << D) / kLanes;

  // 1 in lanes of upper nodes along an axis.
  static V upper(int part, int axis) {
    V bits;
    for (int l = 0; l < kLanes; ++l) {
      bits[l] = static_cast<Real>((part * kLanes + l) >> axis & 1);
    }
    return bits;
  }
  // Weights along an axis: 1 - f or f.
  SUBSTEP_INLINE static V weight(const V& upper, Real f) {
    return fma<V>(2 * upper - 1, splat<V>(f), 1 - upper);
  }
};

}  // namespace substep::gridfluid
