// The nodes that the particles of one block reach, side by side: kArena^D nodes, the last axis
// fastest, as the 2^D node blocks of BlockLayout::arenas hold them.
#pragma once

#include <cstring>

#include "substep/transfer/blocks.h"

namespace substep::transfer {

template <class Real, int D>
struct Arena {
  static constexpr int kNodes = D == 3 ? 512 : 64;
  alignas(64) Real values[kNodes * kNodeReals];

  void clear() { std::memset(values, 0, sizeof values); }
  // Node (i, j) has the offset 8 i + j, node (i, j, k) 64 i + 8 j + k.
  Real* node(int offset) { return values + offset * kNodeReals; }
  const Real* node(int offset) const { return values + offset * kNodeReals; }

  using Blocks = std::array<std::int32_t, 1 << D>;
  void gather(const NodeBlocks<Real, D>& nodes, const Blocks& blocks) {
    rows(blocks, [&](std::int32_t block, int at, Real* row) {
      std::memcpy(row, nodes.block(block) + at, kRow * sizeof(Real));
    });
  }
  void add_to(NodeBlocks<Real, D>& nodes, const Blocks& blocks) {
    rows(blocks, [&](std::int32_t block, int at, const Real* row) {
      Real* to = nodes.block(block) + at;
      for (int r = 0; r < kRow; ++r) to[r] += row[r];
    });
  }

 private:
  static constexpr int kRow = kBlock * kNodeReals;  // nodes of a block along the last axis
  // visit(node block, first number there, row here) for each row of nodes.
  template <class Visit>
  void rows(const Blocks& blocks, Visit&& visit) {
    constexpr int kRows = D == 3 ? kBlock * kBlock : kBlock;
    for (int corner = 0; corner < 1 << D; ++corner) {
      const std::int32_t block = blocks[static_cast<std::size_t>(corner)];
      const int x = kBlock * (corner >> (D - 1)), y = kBlock * ((corner >> (D - 2)) & 1);
      for (int r = 0; r < kRows; ++r) {
        int node = (x + r) * kArena + y;
        if constexpr (D == 3) {
          const int z = kBlock * (corner & 1);
          node = ((x + r / kBlock) * kArena + y + r % kBlock) * kArena + z;
        }
        visit(block, r * kRow, values + node * kNodeReals);
      }
    }
  }
};

}  // namespace substep::transfer
