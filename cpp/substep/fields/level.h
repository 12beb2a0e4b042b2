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

enum class Place : std::int8_t { kSea = 0, kLand = 1, kOutside = 2 };

}  // namespace substep::fields
