// Where the particles of a packet are now: in which block beside their own, and in which of its
// cells.
#pragma once

#include <array>
#include <cstdint>

#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

template <int D>
struct Cells {
  static constexpr int kNeighbours = D == 3 ? 27 : 9;  // blocks at -1, 0, 1 along each axis
  static constexpr int kCells = D == 3 ? 64 : 16;      // of a block

  // Along one axis. A particle that left both neighbours' reach counts as at their edge.
  struct Axis {
    int neighbour, cell;  // 0, 1, 2; 0 to 3
  };
  template <class Real>
  static Axis axis(Real x) {
    int cell = static_cast<int>(x + static_cast<Real>(transfer::kBlock - kFirstPosition));
    cell = cell < 0 ? 0 : cell > 11 ? 11 : cell;
    return {cell >> 2, cell & 3};
  }
  struct Where {
    std::int16_t neighbour, cell;
  };
  // x[d * stride].
  template <class Real>
  static Where where(const Real* x, int stride) {
    int neighbour = 0, cell = 0;
    for (int d = 0; d < D; ++d) {
      const Axis a = axis(x[d * stride]);
      neighbour = neighbour * 3 + a.neighbour;
      cell = cell * 4 + a.cell;
    }
    return {static_cast<std::int16_t>(neighbour), static_cast<std::int16_t>(cell)};
  }
  // Difference of the keys of a neighbour and a block.
  static std::uint64_t offset(int neighbour) {
    std::uint64_t offset = 0;
    for (int d = D - 1; d >= 0; --d, neighbour /= 3) {
      offset += static_cast<std::uint64_t>(neighbour % 3 - 1) * transfer::BlockKey<D>::unit(d);
    }
    return offset;
  }
};

}  // namespace substep::mpm
