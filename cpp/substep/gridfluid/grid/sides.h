// The sides of a grid's box.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// Whether the lower and the upper side of each axis is open: pressure 0 beyond.
template <int D>
using OpenSides = std::array<std::array<bool, 2>, D>;

// each(cell, ghost, face) for the outermost cells along an axis, on its lower (0) or upper (1)
// side, what is beyond them, and the face between.
template <int D, class Each>
void for_side(const Layout<D>& layout, int axis, int side, const Each& each) {
  const std::size_t a = usize(axis);
  std::array<int, D> from{}, to = layout.cells;
  if (side == 1) from[a] = layout.cells[a] - 1;
  to[a] = from[a] + 1;
  const std::int64_t s = layout.stride[a];
  std::array<int, D> cell = from;
  do {
    const std::int64_t i = layout.index(cell);
    each(i, side == 0 ? i - s : i + s, side == 0 ? i : i + s);
  } while (next_in_block(cell, from, to));
}

// Ghosts of periodic axes become what is in the cells on the other side. Where x is of the faces of
// such an axis, the last face becomes the first, which is the same.
template <class T, int D>
void wrap(const Layout<D>& layout, std::span<T> x) {
  for (std::size_t a = 0; a < D; ++a) {
    if (!layout.periodic[a]) continue;
    const std::int64_t s = layout.stride[a], n = layout.cells[a];
    std::array<int, D> from, to;  // ghosts of the other axes too
    for (std::size_t b = 0; b < D; ++b) from[b] = -1, to[b] = layout.cells[b] + 1;
    from[a] = 0, to[a] = 1;
    std::array<int, D> cell = from;
    do {
      const std::int64_t i = layout.index(cell);
      x[usize(i - s)] = x[usize(i + (n - 1) * s)];
      x[usize(i + n * s)] = x[usize(i)];
    } while (next_in_block(cell, from, to));
  }
}

}  // namespace substep::gridfluid
