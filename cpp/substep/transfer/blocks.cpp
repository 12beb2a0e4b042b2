#include "substep/transfer/blocks.h"

#include <algorithm>
#include <cstring>
#include <iterator>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::transfer {

template <int D>
void BlockLayout<D>::assign(std::vector<std::uint64_t> keys) {
  particle_keys = std::move(keys);

  // Node blocks: particle blocks and their neighbours above, axis by axis.
  node_keys = particle_keys;
  std::vector<std::uint64_t> above, both;
  for (int d = D - 1; d >= 0; --d) {
    above = node_keys;
    for (std::uint64_t& key : above) key += BlockKey<D>::unit(d);
    both.clear();
    std::set_union(node_keys.begin(), node_keys.end(), above.begin(), above.end(),
                   std::back_inserter(both));
    node_keys.swap(both);
  }

  arenas.resize(particle_keys.size());
  for (int corner = 0; corner < kCorners; ++corner) {
    std::uint64_t offset = 0;
    for (int d = 0; d < D; ++d) {
      if (corner >> (D - 1 - d) & 1) offset += BlockKey<D>::unit(d);
    }
    match(particle_keys, offset, node_keys, [&](std::size_t block, std::size_t node_block) {
      arenas[block][usize(corner)] = static_cast<std::int32_t>(node_block);
    });
  }

  for (auto& colour : colours) colour.clear();
  for (std::size_t block = 0; block < particle_keys.size(); ++block) {
    std::size_t colour = 0;
    for (const std::int32_t coordinate : BlockKey<D>::unpack(particle_keys[block])) {
      colour = colour << 1 | usize(coordinate & 1);
    }
    colours[colour].push_back(static_cast<std::int32_t>(block));
  }
}

template <class Real, int D>
void NodeBlocks<Real, D>::set_zero(std::int64_t blocks, int threads) {
  values.reset(usize(blocks) * kReals);
  parallel_for(
      blocks, 256,
      [&](std::int64_t begin, std::int64_t end) {
        std::memset(block(begin), 0, usize(end - begin) * kReals * sizeof(Real));
      },
      threads);
}

template struct BlockLayout<2>;
template struct BlockLayout<3>;
template struct NodeBlocks<float, 2>;
template struct NodeBlocks<float, 3>;
template struct NodeBlocks<double, 2>;
template struct NodeBlocks<double, 3>;

}  // namespace substep::transfer
