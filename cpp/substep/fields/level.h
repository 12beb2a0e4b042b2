// What grids of all forms have in common: the values on their nodes at one time.
#pragma once

#include <cstdint>
#include <vector>

namespace substep::fields {

template <class T>
struct alignas(4 * sizeof(T)) Node {
  T value[4];
};

// The nodes at one time, as the grid arranges them.
template <class T>
struct Level {
  std::vector<Node<T>> nodes;
  std::vector<std::uint8_t> whole;  // cubic only: no missing node in the stencil of this cell
};

// Where and how to interpolate in time: (1 - weight) low + weight high.
template <class T>
struct Slice {
  const Level<T>* low = nullptr;
  const Level<T>* high = nullptr;  // null: low alone
  T weight = 0;
};

// Blocks of 4 cells along each of three axes, numbered one axis after the other, for sorting; there
// are so many nodes along each.
inline std::int64_t blocks_along(std::int64_t nodes) { return nodes / 4 + 1; }
inline std::int64_t block_of(const std::int64_t cell[3], const std::int64_t nodes[3]) {
  return (cell[0] / 4 * blocks_along(nodes[1]) + cell[1] / 4) * blocks_along(nodes[2]) +
         cell[2] / 4;
}
inline std::int64_t blocks_in(const std::int64_t nodes[3]) {
  return blocks_along(nodes[0]) * blocks_along(nodes[1]) * blocks_along(nodes[2]);
}

enum class Place : std::int8_t { kSea = 0, kLand = 1, kOutside = 2 };

}  // namespace substep::fields
