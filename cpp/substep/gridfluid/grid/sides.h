// The sides of a grid's box.
#pragma once

#include <array>
#include <cstdint>

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

}  // namespace substep::gridfluid
