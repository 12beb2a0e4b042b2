// Where the numbers of a grid are: cells of a box in rows along the last axis, with a layer of
// ghost cells around, and faces at the cells above them.
//
// A staggered (marker-and-cell) grid: Harlow and Welch, "Numerical calculation of time-dependent
// viscous incompressible flow of fluid with free surface", 1965. All arrays of a grid, of cells and
// of faces, have this one layout: number i of component a of the velocity stands at the face
// between cell i and cell i - stride[a]. So an axis of n cells has cells 0 to n - 1, ghosts -1 and
// n, and faces 0 to n. Loops run over rows, whose first cells are aligned to a cache line of
// floats.
#pragma once

#include <array>
#include <cstdint>

#include "substep/core/usize.h"

namespace substep::gridfluid {

template <int D>
struct Layout {
  static_assert(D == 2 || D == 3);

  explicit Layout(const std::array<int, D>& cells_, const std::array<bool, D>& periodic_ = {})
      : cells(cells_), periodic(periodic_) {
    stride[D - 1] = 1;
    stride[D - 2] = (cells[D - 1] + 2 + kAlign - 1) / kAlign * kAlign;
    if constexpr (D == 3) stride[0] = stride[1] * (cells[1] + 2);
    first = kAlign;
    for (int a = 0; a < D - 1; ++a) first += stride[usize(a)];
    size = first + (cells[0] + 1) * stride[0];
  }

  // Rows of cells, or of the faces of an axis: along it there is one more.
  std::int64_t rows(int faces_of = -1) const {
    return D == 2 ? along(0, faces_of) : std::int64_t{along(0, faces_of)} * along(1, faces_of);
  }
  // The first cell or face of row r.
  std::int64_t row(std::int64_t r, int faces_of = -1) const {
    if constexpr (D == 2) {
      return first + r * stride[0];
    } else {
      const int n = along(1, faces_of);
      return first + r / n * stride[0] + r % n * stride[1];
    }
  }
  int row_length(int faces_of = -1) const { return along(D - 1, faces_of); }
  // each(cell), row by row.
  template <class Each>
  void for_cells(const Each& each) const {
    for (std::int64_t r = 0; r < rows(); ++r) {
      for (std::int64_t i = row(r), end = i + row_length(); i < end; ++i) each(i);
    }
  }
  std::int64_t index(const std::array<int, D>& cell) const {
    std::int64_t i = first;
    for (std::size_t a = 0; a < D; ++a) i += cell[a] * stride[a];
    return i;
  }
  std::array<int, D> cell(std::int64_t i) const {
    std::array<int, D> at;
    std::int64_t rest = i - first;
    for (std::size_t a = 0; a < D; ++a) {
      at[a] = static_cast<int>(rest / stride[a]);
      rest %= stride[a];
    }
    return at;
  }
  std::int64_t count() const { return rows() * row_length(); }

  std::array<int, D> cells;
  std::array<bool, D> periodic;        // whether what leaves on one side comes in on the other
  std::array<std::int64_t, D> stride;  // of a cell along each axis
  std::int64_t first;                  // of cell 0, 0, 0
  std::int64_t size;                   // numbers in an array, ghosts included

 private:
  static constexpr int kAlign = 16;

  int along(int axis, int faces_of) const { return cells[usize(axis)] + (axis == faces_of); }
};

// The one after a cell of a block from `from` to below `to`; false, and the first, after the last.
template <std::size_t D>
bool next_in_block(std::array<int, D>& cell, const std::array<int, D>& from,
                   const std::array<int, D>& to) {
  for (std::size_t a = D; a-- > 0;) {
    if (++cell[a] < to[a]) return true;
    cell[a] = from[a];
  }
  return false;
}

}  // namespace substep::gridfluid
