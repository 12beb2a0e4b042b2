// Blocks of 4^D nodes of an unbounded grid, only where they are needed.
//
// Nodes are numbered by integers; block b holds the nodes 4 b to 4 b + 3 along each axis. Particles
// belong to cells of blocks too: particle block b holds the particles whose stencil begins at node
// 4 b + 1 to 4 b + 4 (of a quadratic spline: 1.5 <= x < 5.5 cells from node 4 b), and so reaches,
// with one node to spare on either side, the nodes 4 b to 4 b + 7: its arena, which is the 2^D node
// blocks b to b + 1. Arenas of blocks of the same parity do not meet, so 2^D colours of particle
// blocks scatter in parallel, in a fixed order, without atomics.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/usize.h"

namespace substep::transfer {

inline constexpr int kBlock = 4;      // nodes of a block along an axis
inline constexpr int kArena = 8;      // nodes of an arena along an axis
inline constexpr int kNodeReals = 4;  // per node: momentum or velocity (D), then mass; padded

template <int D>
using Index = std::array<std::int32_t, D>;

// Coordinates of a block in one number, whose order is lexicographic: 21 bits per axis in 3D, 32
// in 2D. Coordinates beyond +-2^20 (3D) are refused by the caller.
template <int D>
struct BlockKey {
  static constexpr int kBits = D == 3 ? 21 : 30;  // coordinates of nodes are int32
  static constexpr std::int64_t kLimit = std::int64_t{1} << (kBits - 1);

  // What a key grows by from one block to the next along an axis: keys of neighbours differ by the
  // same number everywhere, so lists of keys stay ascending when all are shifted.
  static constexpr std::uint64_t unit(int d) { return std::uint64_t{1} << kBits * (D - 1 - d); }

  static std::uint64_t pack(const Index<D>& block) {
    std::uint64_t key = 0;
    for (int d = 0; d < D; ++d) {
      key = key << kBits | static_cast<std::uint64_t>(block[usize(d)] + kLimit);
    }
    return key;
  }
  static Index<D> unpack(std::uint64_t key) {
    Index<D> block;
    for (int d = D - 1; d >= 0; --d, key >>= kBits) {
      block[usize(d)] = static_cast<std::int32_t>(
          static_cast<std::int64_t>(key & ((std::uint64_t{1} << kBits) - 1)) - kLimit);
    }
    return block;
  }
};

// Calls found(i, j) for all i, j with keys[i] + offset = others[j]; both lists ascend.
template <class Found>
void match(std::span<const std::uint64_t> keys, std::uint64_t offset,
           std::span<const std::uint64_t> others, Found&& found) {
  for (std::size_t i = 0, j = 0; i < keys.size(); ++i) {
    while (j < others.size() && others[j] < keys[i] + offset) ++j;
    if (j < others.size() && others[j] == keys[i] + offset) found(i, j);
  }
}

// Which blocks there are: particle blocks in ascending order of their keys, the node blocks that
// their arenas need, and the particle blocks of each colour.
template <int D>
struct BlockLayout {
  static constexpr int kCorners = 1 << D;

  std::vector<std::uint64_t> particle_keys;  // ascending
  std::vector<std::uint64_t> node_keys;      // ascending
  // Node blocks of each particle block's arena: corner c has offset ((c >> 2) & 1, (c >> 1) & 1,
  // c & 1) in 3D, so rows along the last axis come first.
  std::vector<std::array<std::int32_t, kCorners>> arenas;
  std::array<std::vector<std::int32_t>, kCorners> colours;  // particle blocks, ascending

  std::int64_t blocks() const { return static_cast<std::int64_t>(particle_keys.size()); }
  std::int64_t node_blocks() const { return static_cast<std::int64_t>(node_keys.size()); }

  // From ascending particle keys.
  void assign(std::vector<std::uint64_t> keys);
};

// Numbers at the nodes of a layout's node blocks: kBlock^D nodes each, the last axis fastest.
template <class Real, int D>
struct NodeBlocks {
  static constexpr int kNodes = D == 3 ? 64 : 16;
  static constexpr int kReals = kNodes * kNodeReals;
  AlignedBuffer<Real> values;

  std::int64_t blocks() const { return static_cast<std::int64_t>(values.size()) / kReals; }
  Real* block(std::int64_t b) { return values.data() + b * kReals; }
  const Real* block(std::int64_t b) const { return values.data() + b * kReals; }
  void set_zero(std::int64_t blocks, int threads);
};

}  // namespace substep::transfer
