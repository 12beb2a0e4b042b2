// Ghost cells of periodic axes.
#pragma once

#include <cstdint>
#include <span>

#include "substep/core/usize.h"
#include "substep/gridfluid/layout.h"

namespace substep::gridfluid {

// Ghosts become what is in the cells on the other side. Where x is of the faces of an axis, the
// last face becomes the first, which is the same.
template <class T, int D>
void wrap_ghosts(const Layout<D>& layout, std::span<T> x) {
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
