// The ghosts around a grid.
//
// Across a periodic axis they are the cells and faces of the other side. A closed side is a mirror
// without friction: a ghost is the cell or tangential face within, so what particles add to it
// counts there (fold_ghosts), and what they read of it is what stands there (fill_ghosts). Faces
// across the axis itself, 0 to n, all lie on the box and have no ghosts that are reached.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// Component for numbers at cell centres: across no axis.
inline constexpr int kCentres = -1;

// at(ghost, inside) for the ghosts on both sides of an axis, and all positions -1 to n along the
// other axes.
template <int D, class At>
void for_ghosts(const Layout<D>& layout, int component, int axis, const At& at, int threads = 1) {
  const auto a = usize(axis);
  const int n = layout.cells[a];
  const bool periodic = layout.periodic[a];
  if (!periodic && component == axis) return;
  const std::int64_t low = layout.first - layout.stride[a];
  const std::int64_t high = layout.first + n * layout.stride[a];
  const std::int64_t inside_low = periodic ? high - layout.stride[a] : layout.first;
  const std::int64_t inside_high = periodic ? layout.first : high - layout.stride[a];
  std::array<std::size_t, 2> others{a == 0 ? usize(1) : usize(0), usize(D - 1)};
  if (a == D - 1) others[1] = D - 2;
  const auto line = [&](std::int64_t offset, std::size_t b) {
    const std::int64_t step = layout.stride[b];
    for (std::int64_t k = -1; k <= layout.cells[b]; ++k) {
      at(low + offset + k * step, inside_low + offset + k * step);
      at(high + offset + k * step, inside_high + offset + k * step);
    }
  };
  if constexpr (D == 2) {
    line(0, others[0]);
  } else {
    constexpr std::int64_t kMany = 4096;  // ghosts that are worth a task
    parallel_for(
        layout.cells[others[0]] + 2, std::max<std::int64_t>(kMany / layout.cells[others[1]], 1),
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t k = begin - 1; k < end - 1; ++k) {
            line(k * layout.stride[others[0]], others[1]);
          }
        },
        threads);
  }
}

// Adds what stands at ghosts to what they are the images of.
template <class Real, int D>
void fold_ghosts(const Layout<D>& layout, int component, Real* sums) {
  for (int axis = 0; axis < D; ++axis) {
    for_ghosts(layout, component, axis,
               [&](std::int64_t ghost, std::int64_t inside) { sums[inside] += sums[ghost]; });
  }
}

// Sets the ghosts of an axis, or of all, to what they are the images of.
template <class T, int D>
void fill_ghosts(const Layout<D>& layout, int component, int axis, T* values, int threads) {
  for_ghosts(
      layout, component, axis,
      [&](std::int64_t ghost, std::int64_t inside) { values[ghost] = values[inside]; }, threads);
}
template <class T, int D>
void fill_ghosts(const Layout<D>& layout, int component, T* values, int threads = 1) {
  for (int axis = 0; axis < D; ++axis) fill_ghosts(layout, component, axis, values, threads);
}

// Sets those of periodic axes only. Where the numbers are of the faces of such an axis, the last
// face becomes the first, which is the same.
template <class T, int D>
void wrap(const Layout<D>& layout, std::span<T> x, int threads) {
  for (int axis = 0; axis < D; ++axis) {
    if (layout.periodic[usize(axis)]) fill_ghosts(layout, kCentres, axis, x.data(), threads);
  }
}

}  // namespace substep::gridfluid
