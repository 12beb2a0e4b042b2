// Loops over the rows and planes of a grid. A plane is what has one index along the first axis: in
// 2D a row.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// A row, and those below and above it along all axes but its own; beyond the end of a periodic
// axis that is the row on the other side.
template <int D>
struct Row {
  std::int64_t at;  // its first cell
  int length;
  std::array<std::int64_t, D - 1> below, above;
  int parity;  // of the sum of the indices of its first cell
};

template <int D, class Use>
void for_rows(const Layout<D>& layout, int plane, const Use& use) {
  const auto around = [&](std::size_t a, int index, Row<D>& row) {
    const int last = layout.cells[a] - 1;
    const bool wraps = layout.periodic[a];
    row.below[a] = row.at + (wraps && index == 0 ? last : -1) * layout.stride[a];
    row.above[a] = row.at - (wraps && index == last ? last : -1) * layout.stride[a];
  };
  const int rows = D == 2 ? 1 : layout.cells[1];
  for (int j = 0; j < rows; ++j) {
    Row<D> row;
    row.at = layout.first + plane * layout.stride[0] + (D == 3 ? j * layout.stride[1] : 0);
    row.length = layout.row_length();
    around(0, plane, row);
    if constexpr (D == 3) around(1, j, row);
    row.parity = (plane + j) & 1;
    use(row);
  }
}

// On a periodic last axis a row's ghost cells are what is on the other side.
template <class Real, int D>
void wrap_row(const Layout<D>& layout, const Row<D>& row, Real* x) {
  if (!layout.periodic[D - 1]) return;
  x[row.at - 1] = x[row.at + row.length - 1];
  x[row.at + row.length] = x[row.at];
}

// Slabs of planes that tasks work on: thick ones where stages follow each other through them.
struct Slabs {
  template <int D>
  explicit Slabs(const Layout<D>& layout, int stages = 1) : planes(layout.cells[0]) {
    constexpr std::int64_t kCells = 1 << 15;  // of a slab, at least
    constexpr std::int64_t kThick = 16;       // planes for each stage that lags behind
    const std::int64_t plane = layout.count() / planes;
    const std::int64_t thick = std::max(kCells / plane, kThick * (stages - 1));
    count = std::max<std::int64_t>(planes / std::max<std::int64_t>(thick, 1), 1);
  }
  int begin(std::int64_t slab) const { return static_cast<int>(planes * slab / count); }
  std::int64_t planes, count;
};

// use(slab, begin, end) for slabs of planes.
template <int D, class Use>
void for_slabs(const Layout<D>& layout, const Use& use, int threads) {
  const Slabs slabs(layout);
  const auto run = [&](std::int64_t s) { use(s, slabs.begin(s), slabs.begin(s + 1)); };
  parallel_chunks(slabs.count, std::cref(run), threads);
}

// stage(s, plane) for s = 0, 1, ... on all planes, where stage s of a plane needs no more than
// stage s - 1 of it and of its two neighbours, and must not come before it. One after the other
// they would read the grid from memory once a stage; here one follows close behind the other
// through each slab, leaving out at its two ends what needs another slab, which is made up for
// afterwards.
template <int kStages, int D, class Stage>
void for_planes_in_stages(const Layout<D>& layout, const Stage& stage, int threads) {
  const Slabs slabs(layout, kStages);
  const auto run = [&](std::int64_t phase, std::int64_t slab) {
    if (slabs.count == 1) {  // no ends
      if (phase > 0) return;
      if (layout.periodic[0]) {
        for (int s = 0; s < kStages; ++s)
          for (int k = 0; k < slabs.planes; ++k) stage(s, k);
      } else {
        for (int t = 0; t < slabs.planes + kStages - 1; ++t)
          for (int s = 0; s < kStages; ++s)
            if (t - s >= 0 && t - s < slabs.planes) stage(s, t - s);
      }
      return;
    }
    const int begin = slabs.begin(slab), end = slabs.begin(slab + 1), n = int(slabs.planes);
    if (phase == 0) {
      for (int t = begin; t < end + kStages - 1; ++t)
        for (int s = 0; s < kStages; ++s)
          if (t - s >= begin + s && t - s < end - s) stage(s, t - s);
    } else {
      const int p = static_cast<int>(phase);
      for (int k = begin - p; k < begin + p; ++k) stage(p, k < 0 ? k + n : k);
    }
  };
  std::array<std::int64_t, kStages> chunks;
  chunks.fill(slabs.count);
  parallel_phases(chunks, std::cref(run), threads);
}

}  // namespace substep::gridfluid
