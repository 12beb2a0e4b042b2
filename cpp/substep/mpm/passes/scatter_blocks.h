// Particle blocks that add to shared nodes, in parallel and always with the same sums.
#pragma once

#include <algorithm>
#include <array>
#include <cstring>
#include <functional>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/mpm/passes/arena.h"

namespace substep::mpm {

inline constexpr std::int64_t kBlocksOfScatter = 4;  // particle blocks per task

// Sets all layers of nodes to zero and calls scatter(block, arena) for every particle block, with
// an arena of zeros that is then added to the nodes: colour by colour, so that no two that run at
// the same time write to the same nodes (of these, or of others that scatter adds to itself).
template <class Real, int D, class ScatterBlock>
void scatter_blocks(const transfer::BlockLayout<D>& layout, Nodes<Real, D>& nodes, int threads,
                    ScatterBlock&& scatter, std::int64_t layers = 1) {
  constexpr std::int64_t kZeroGrain = 256;
  const std::int64_t all = layers * layout.node_blocks();
  nodes.values.reset(usize(all) * Nodes<Real, D>::kReals);
  std::array<std::int64_t, transfer::BlockLayout<D>::kCorners + 1> chunks;
  chunks[0] = (all + kZeroGrain - 1) / kZeroGrain;
  for (std::size_t colour = 0; colour < layout.colours.size(); ++colour) {
    const auto blocks = static_cast<std::int64_t>(layout.colours[colour].size());
    chunks[colour + 1] = (blocks + kBlocksOfScatter - 1) / kBlocksOfScatter;
  }
  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    if (phase == 0) {
      const std::int64_t first = chunk * kZeroGrain;
      const std::int64_t blocks = std::min(kZeroGrain, all - first);
      std::memset(nodes.block(first), 0, usize(blocks) * Nodes<Real, D>::kReals * sizeof(Real));
      return;
    }
    const auto& colour = layout.colours[usize(phase - 1)];
    const auto end = std::min(usize((chunk + 1) * kBlocksOfScatter), colour.size());
    for (auto i = usize(chunk * kBlocksOfScatter); i < end; ++i) {
      const auto block = usize(colour[i]);
      Arena<Real, D> arena;
      arena.set_zero();
      scatter(block, arena);
      arena.add_to(nodes, layout, block);
    }
  };
  parallel_phases(chunks, std::cref(run), threads);  // by reference: so it needs no memory
}

}  // namespace substep::mpm
