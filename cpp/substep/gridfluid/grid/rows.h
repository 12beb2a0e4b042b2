// Loops over the rows and planes of a grid, as far as there is fluid in them. A plane is what has
// one index along the first axis: in 2D a row.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// Which part of each row is looked at: all of it, or what holds all its fluid.
template <int D>
class FluidRows {
 public:
  struct Part {
    int begin, end;
  };

  explicit FluidRows(const Layout<D>& layout)
      : layout_(layout),
        parts_(usize(layout.rows()), {0, layout.row_length()}),
        before_(parts_),
        cells_(usize(layout.cells[0]), rows_of_plane() * layout.row_length()) {}

  // part_of(r), which may be empty: begin >= end. Ends are set to whole lanes.
  template <class PartOf>
  void set(const PartOf& part_of, int threads) {
    constexpr int kLanes = 16;
    const int n = layout_.row_length();
    before_.swap(parts_);
    parallel_for(
        layout_.rows(), 512,
        [&](std::int64_t first, std::int64_t last) {
          for (std::int64_t r = first; r < last; ++r) {
            const Part part = part_of(r);
            Part& to = parts_[usize(r)];
            to = {part.begin / kLanes * kLanes,
                  std::min((part.end + kLanes - 1) / kLanes * kLanes, n)};
            if (part.begin >= part.end) {
              to = {0, 0};
            } else if (layout_.periodic[D - 1]) {
              to = {0, n};
            }
          }
        },
        threads);
    std::fill(cells_.begin(), cells_.end(), 0);
    for (std::int64_t r = 0; r < layout_.rows(); ++r)
      cells_[usize(r / rows_of_plane())] += parts_[usize(r)].end - parts_[usize(r)].begin;
  }
  // Zeros where numbers were looked at before set(), and are no more.
  template <class Real>
  void clear(Real* x, int threads) const {
    parallel_for(
        layout_.rows(), 512,
        [&](std::int64_t first, std::int64_t last) {
          for (std::int64_t r = first; r < last; ++r) {
            const Part was = before_[usize(r)], is = parts_[usize(r)];
            if (was.begin >= is.begin && was.end <= is.end) continue;
            Real* const row = x + layout_.row(r);
            const int split = std::clamp(is.begin, was.begin, was.end);
            std::fill(row + was.begin, row + split, Real(0));
            std::fill(row + std::clamp(is.end, split, was.end), row + was.end, Real(0));
          }
        },
        threads);
  }
  const Layout<D>& layout() const { return layout_; }
  Part part(std::int64_t r) const { return parts_[usize(r)]; }
  std::int64_t rows_of_plane() const { return D == 2 ? 1 : layout_.cells[1]; }
  std::int64_t cells_of_plane(int plane) const { return cells_[usize(plane)]; }

 private:
  Layout<D> layout_;
  std::vector<Part> parts_, before_;
  std::vector<std::int64_t> cells_;  // of the parts of each plane
};

// The looked at part of a row, and the cells below and above its first one along all axes but its
// own; beyond the end of a periodic axis that is what is on the other side.
template <int D>
struct Row {
  std::int64_t at;    // its first cell
  int begin, length;  // the index of that along the row; 0 cells where there is no fluid
  std::array<std::int64_t, D - 1> below, above;
  int parity;  // of the sum of the indices of its first cell
};

template <int D, class Use>
void for_rows(const FluidRows<D>& fluid, int plane, const Use& use) {
  const Layout<D>& layout = fluid.layout();
  const auto around = [&](std::size_t a, int index, Row<D>& row) {
    const int last = layout.cells[a] - 1;
    const bool wraps = layout.periodic[a];
    row.below[a] = row.at + (wraps && index == 0 ? last : -1) * layout.stride[a];
    row.above[a] = row.at - (wraps && index == last ? last : -1) * layout.stride[a];
  };
  const auto rows = static_cast<int>(fluid.rows_of_plane());
  for (int j = 0; j < rows; ++j) {
    const auto part = fluid.part(std::int64_t{plane} * rows + j);
    Row<D> row;
    row.begin = part.begin;
    row.length = part.end - part.begin;
    row.at =
        layout.first + plane * layout.stride[0] + (D == 3 ? j * layout.stride[1] : 0) + part.begin;
    around(0, plane, row);
    if constexpr (D == 3) around(1, j, row);
    row.parity = (plane + j + part.begin) & 1;
    use(row);
  }
}

// each(begin, end) for the numbers of those cells of each row.
template <int D, class Each>
void for_fluid_cells(const FluidRows<D>& fluid, int threads, const Each& each) {
  const Layout<D>& layout = fluid.layout();
  parallel_for(
      layout.rows(), 64,
      [&](std::int64_t first, std::int64_t last) {
        for (std::int64_t r = first; r < last; ++r) {
          const auto [begin, end] = fluid.part(r);
          each(layout.row(r) + begin, layout.row(r) + end);
        }
      },
      threads);
}

// each(axis, begin, end) for the numbers of the faces beside them.
template <int D, class Each>
void for_fluid_faces(const FluidRows<D>& fluid, int threads, const Each& each) {
  using Part = typename FluidRows<D>::Part;
  const Layout<D>& layout = fluid.layout();
  const std::int64_t nk = layout.cells[0], nj = fluid.rows_of_plane();
  const std::int64_t rows_of_plane = D == 2 ? 1 : nj + 1;
  const auto wrapped = [&](std::int64_t index, std::size_t a) {
    const std::int64_t n = layout.cells[a];
    return layout.periodic[a] ? (index + n) % n : index;
  };
  const auto part_at = [&](std::int64_t k, std::int64_t j) -> Part {
    k = wrapped(k, 0);
    if (D == 3) j = wrapped(j, 1);
    const bool inside = k >= 0 && k < nk && j >= 0 && j < nj;
    return inside ? fluid.part(k * nj + j) : Part{0, 0};
  };
  const auto either = [](Part a, Part b) -> Part {
    if (a.begin == a.end) return b;
    if (b.begin == b.end) return a;
    return {std::min(a.begin, b.begin), std::max(a.end, b.end)};
  };
  parallel_for((nk + 1) * rows_of_plane, 64,
               [&](std::int64_t first, std::int64_t last) {
                 for (std::int64_t r = first; r < last; ++r) {
                   const std::int64_t k = r / rows_of_plane, j = r % rows_of_plane;
                   const std::int64_t at =
                       layout.first + k * layout.stride[0] + (D == 3 ? j * layout.stride[1] : 0);
                   const auto use = [&](std::size_t a, Part part) {
                     if (part.begin < part.end) each(a, at + part.begin, at + part.end);
                   };
                   if (j < nj) use(0, either(part_at(k, j), part_at(k - 1, j)));
                   if (D == 3 && k < nk) use(1, either(part_at(k, j), part_at(k, j - 1)));
                   if (k == nk || j == nj) continue;
                   const Part part = fluid.part(k * nj + j);
                   use(D - 1, {part.begin, part.end + (part.begin < part.end ? 1 : 0)});
                 }
               },
               threads);
}

// On a periodic last axis a row's ghost cells are what is on the other side.
template <class Real, int D>
void wrap_row(const Layout<D>& layout, const Row<D>& row, Real* x) {
  if (!layout.periodic[D - 1]) return;
  x[row.at - 1] = x[row.at + row.length - 1];
  x[row.at + row.length] = x[row.at];
}

// Slabs of planes that tasks work on, with about as much fluid in each: thick ones where stages
// follow each other through them.
template <int D>
struct Slabs {
  explicit Slabs(const FluidRows<D>& fluid, int stages = 1) {
    constexpr std::int64_t kShares = 64, kCells = 1 << 11;  // so many at most, cells at least
    constexpr int kThick = 16, kThin = 3;  // planes for each stage that lags behind
    const int planes = fluid.layout().cells[0];
    std::int64_t cells = 0;
    int wet = 0;
    for (int k = 0; k < planes; ++k) {
      cells += fluid.cells_of_plane(k);
      wet += fluid.cells_of_plane(k) > 0;
    }
    const std::int64_t share = std::max(cells / kShares, kCells);
    const int thick = std::clamp(wet / 32, kThin, kThick) * (stages - 1);
    std::int64_t sum = 0;
    for (int k = 0; k < planes; ++k) {
      sum += fluid.cells_of_plane(k);
      if (sum < share || k + 1 - begin.back() < thick || planes - k - 1 < thick) continue;
      begin.push_back(k + 1);
      sum = 0;
    }
    if (begin.back() < planes) begin.push_back(planes);
  }
  std::int64_t count() const { return static_cast<std::int64_t>(begin.size()) - 1; }

  std::vector<int> begin{0};  // of each, and the end of the last
};

// use(slab, begin, end) for slabs of planes.
template <int D, class Use>
void for_slabs(const Slabs<D>& slabs, const Use& use, int threads) {
  const auto run = [&](std::int64_t s) {
    use(s, slabs.begin[usize(s)], slabs.begin[usize(s + 1)]);
  };
  parallel_chunks(slabs.count(), std::cref(run), threads);
}
template <int D, class Use>
void for_slabs(const FluidRows<D>& fluid, const Use& use, int threads) {
  for_slabs(Slabs<D>(fluid), use, threads);
}

// stage(s, plane) for s = 0, 1, ... on all planes, where stage s of a plane needs no more than
// stage s - 1 of it and of its two neighbours, and must not come before it. One after the other
// they would read the grid from memory once a stage; here one follows close behind the other
// through each slab, leaving out at its two ends what needs another slab, which is made up for
// afterwards.
template <int kStages, int D, class Stage>
void for_planes_in_stages(const FluidRows<D>& fluid, const Stage& stage, int threads) {
  const Slabs<D> slabs(fluid, kStages);
  const int n = fluid.layout().cells[0];
  const auto run = [&](std::int64_t phase, std::int64_t slab) {
    if (slabs.count() == 1) {  // no ends
      if (phase > 0) return;
      if (fluid.layout().periodic[0]) {
        for (int s = 0; s < kStages; ++s)
          for (int k = 0; k < n; ++k) stage(s, k);
      } else {
        for (int t = 0; t < n + kStages - 1; ++t)
          for (int s = 0; s < kStages; ++s)
            if (t - s >= 0 && t - s < n) stage(s, t - s);
      }
      return;
    }
    const int begin = slabs.begin[usize(slab)], end = slabs.begin[usize(slab + 1)];
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
  chunks.fill(slabs.count());
  parallel_phases(chunks, std::cref(run), threads);
}

}  // namespace substep::gridfluid
