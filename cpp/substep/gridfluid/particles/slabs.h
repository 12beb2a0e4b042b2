// Sums of particles on a grid, in parallel and in a fixed order: slabs of planes of cells add to
// the planes around them, first every second slab, then the others. So no two of those at work
// meet, and each node gets its sums in one order.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/particles/particles.h"

namespace substep::gridfluid {

// Planes of cells in a slab; two of them keep the slabs on both sides apart.
template <int D>
int slab_planes(const Layout<D>& layout) {
  constexpr int kSlabs = 64;
  return std::max(2, layout.cells[0] / kSlabs);
}

// row(index of its first cell, its place across, first particle, last particle + 1) for the rows of
// a slab that have particles.
template <class Real, int D, class Row>
void for_rows_of_slab(const Particles<Real, D>& particles, const Layout<D>& layout,
                      std::int64_t slab, const Row& row) {
  const std::int64_t rows_of_plane = layout.rows() / layout.cells[0];
  const std::int64_t rows = slab_planes(layout) * rows_of_plane;
  for (std::int64_t r = slab * rows; r < std::min((slab + 1) * rows, layout.rows()); ++r) {
    const std::int64_t cell = layout.row(r);
    const std::int32_t begin = particles.first()[cell];
    const std::int32_t end = particles.first()[cell + layout.row_length()];
    if (begin == end) continue;
    std::array<int, D - 1> across;
    across[0] = static_cast<int>(r / rows_of_plane);
    if constexpr (D == 3) across[1] = static_cast<int>(r % rows_of_plane);
    row(cell, across, begin, end);
  }
}

// One after the other: clear(begin, end) for pieces of the grid's arrays, add(slab),
// fold(component), finish(begin, end), fill(component).
template <int D, class Clear, class Add, class Fold, class Finish, class Fill>
void add_by_slabs(const Layout<D>& layout, int components, const Clear& clear, const Add& add,
                  const Fold& fold, const Finish& finish, const Fill& fill, int threads) {
  const std::int64_t pieces = layout.cells[0];
  const std::int64_t slabs = (layout.cells[0] - 1) / slab_planes(layout) + 1;
  const std::array<std::int64_t, 6> chunks{pieces,     (slabs + 1) / 2, slabs / 2,
                                           components, pieces,          components};
  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const std::int64_t begin = layout.size * chunk / pieces;
    const std::int64_t end = layout.size * (chunk + 1) / pieces;
    switch (phase) {
      case 0:
        return clear(begin, end);
      case 1:
        return add(2 * chunk);
      case 2:
        return add(2 * chunk + 1);
      case 3:
        return fold(static_cast<int>(chunk));
      case 4:
        return finish(begin, end);
      default:
        return fill(static_cast<int>(chunk));
    }
  };
  parallel_phases(chunks, std::cref(run), threads);
}

// Where the particles are, one array an axis.
template <class Real, int D>
std::array<const Real*, D> positions(const Particles<Real, D>& particles) {
  std::array<const Real*, D> x;
  for (int d = 0; d < D; ++d) x[usize(d)] = particles.x(d);
  return x;
}

}  // namespace substep::gridfluid
