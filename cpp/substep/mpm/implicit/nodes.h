// The nodes of an implicit step that have mass, one after the other in the order of their blocks:
// kNodeLanes<D> doubles each in all arrays of unknowns (in 3D the fourth is 0).
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "substep/core/usize.h"
#include "substep/mpm/implicit/stencil.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

template <int D>
struct ImplicitNodes {
  static constexpr int kLanesPerNode = kNodeLanes<D>;
  static constexpr int kPerBlock = transfer::NodeBlocks<double, D>::kNodes;

  const transfer::BlockLayout<D>* layout = nullptr;
  std::vector<std::int32_t> index;  // of each node of each block: -1 where there is no mass
  std::vector<std::int64_t> slots;  // and back: node block * kPerBlock + node
  std::vector<double> mass;         // [kg]

  std::size_t count() const { return slots.size(); }
  std::size_t unknowns() const { return count() * kLanesPerNode; }

  // From nodes (p or v (D), then mass). Keeps those whose mass carries digits.
  template <class Real>
  void assign(const transfer::BlockLayout<D>& blocks, std::span<const Real> nodes) {
    layout = &blocks;
    index.assign(blocks.node_keys.size() * kPerBlock, -1);
    slots.clear();
    mass.clear();
    for (std::size_t n = 0; n < index.size(); ++n) {
      const Real m = nodes[n * transfer::kNodeReals + D];
      if (!(m >= std::numeric_limits<Real>::min())) continue;
      index[n] = static_cast<std::int32_t>(slots.size());
      slots.push_back(static_cast<std::int64_t>(n));
      mass.push_back(static_cast<double>(m));
    }
  }

  // Coordinates of node i, integers.
  transfer::Index<D> coordinates(std::size_t i) const {
    const auto slot = usize(slots[i]);
    auto at = transfer::BlockKey<D>::unpack(layout->node_keys[slot / kPerBlock]);
    std::size_t local = slot % kPerBlock;
    for (std::size_t d = D; d-- > 0; local /= transfer::kBlock) {
      at[d] = at[d] * transfer::kBlock + static_cast<std::int32_t>(local % transfer::kBlock);
    }
    return at;
  }

  // Calls body(node of the arena, index of its unknowns) for the nodes with mass of a particle
  // block's arena, in the order of the node blocks.
  template <class Body>
  void for_arena(std::size_t particle_block, const Body& body) const {
    for (int corner = 0; corner < (1 << D); ++corner) {
      const auto block = usize(layout->arenas[particle_block][usize(corner)]);
      for (int n = 0; n < kPerBlock; ++n) {
        const std::int32_t i = index[block * kPerBlock + usize(n)];
        if (i < 0) continue;
        int at = 0;
        for (int d = 0; d < D; ++d) {
          const int shift = 2 * (D - 1 - d);
          const int along = (n >> shift & 3) + 4 * (corner >> (D - 1 - d) & 1);
          at = at * transfer::kArena + along;
        }
        body(at, usize(i));
      }
    }
  }
};

}  // namespace substep::mpm
