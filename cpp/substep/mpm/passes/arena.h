// The nodes that the particles of a block reach, as one array of 8^D: copied from the 2^D node
// blocks, or added to them.
#pragma once

#include <cstring>

#include "substep/core/usize.h"
#include "substep/mpm/passes/transfers.h"

namespace substep::mpm {

template <class Real, int D>
struct alignas(64) Arena {
  static constexpr int kRow = transfer::kArena * transfer::kNodeReals;  // along the last axis
  static constexpr int kHalf = kRow / 2;                                // of one node block
  static constexpr int kRows = D == 3 ? 64 : 8;
  static constexpr int kReals = kRows * kRow;
  Real nodes[kReals + kHalf];  // a stencil's row may read past the last one

  void set_zero() { std::memset(nodes, 0, sizeof nodes); }

  // Of a layer of the nodes.
  void copy(const Nodes<Real, D>& from, const transfer::BlockLayout<D>& layout, std::size_t block,
            int layer = 0) {
    const std::int64_t shift = layer * layout.node_blocks();
    for_each_half(layout.arenas[block], [&](std::int64_t b, int offset, Real* half) {
      std::memcpy(half, from.block(b + shift) + offset, kHalf * sizeof(Real));
    });
    std::memset(nodes + kReals, 0, kHalf * sizeof(Real));
  }

  void add_to(Nodes<Real, D>& to, const transfer::BlockLayout<D>& layout, std::size_t block,
              int layer = 0) {
    const std::int64_t shift = layer * layout.node_blocks();
    for_each_half(layout.arenas[block], [&](std::int64_t b, int offset, const Real* half) {
      using V = Vector<Real>;
      Real* const node = to.block(b + shift) + offset;
      for (int i = 0; i < kHalf; i += kLanes<Real>) {
        const V sum = load<V>(node + i) + load<V>(half + i);
        std::memcpy(node + i, &sum, sizeof sum);
      }
    });
  }

 private:
  // The four nodes of a row that one node block has.
  template <class Each>
  void for_each_half(const std::array<std::int32_t, (1 << D)>& blocks, Each&& each) {
    for (int row = 0; row < kRows; ++row) {
      const int i = D == 3 ? row >> 3 : 0, j = row & 7;
      const int corner = (i >> 2 << 2) + (j >> 2 << 1);
      const int offset = ((i & 3) * 4 + (j & 3)) * kHalf;
      for (int k = 0; k < 2; ++k) {
        each(blocks[usize(corner + k)], offset, nodes + row * kRow + k * kHalf);
      }
    }
  }
};

}  // namespace substep::mpm
