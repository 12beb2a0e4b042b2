// Loops over boxes of cells or faces, row by row, and sums over them that are the same bits for any
// number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

// Cells from `from` to below `to`.
template <int D>
struct Block {
  std::array<int, D> from{}, to{};

  std::int64_t rows() const {
    std::int64_t n = 1;
    for (std::size_t a = 0; a + 1 < D; ++a) n *= to[a] > from[a] ? to[a] - from[a] : 0;
    return to[D - 1] > from[D - 1] ? n : 0;
  }
  std::array<int, D> row(std::int64_t r) const {
    std::array<int, D> cell = from;
    for (std::size_t a = D - 1; a-- > 0;) {
      cell[a] += static_cast<int>(r % (to[a] - from[a]));
      r /= to[a] - from[a];
    }
    return cell;
  }
  int length() const { return to[D - 1] - from[D - 1]; }
};

template <int D>
Block<D> all_cells(const Layout<D>& layout) {
  return {{}, layout.cells};
}
template <int D>
Block<D> all_faces(const Layout<D>& layout, std::size_t axis) {
  Block<D> block{{}, layout.cells};
  ++block.to[axis];
  return block;
}

constexpr std::int64_t kRowsOfTask = 8;

// each(cell, begin, end) for the numbers of each row, with the cell or face it begins with; `grain`
// rows are a task.
template <int D, class Each>
void for_placed_rows(const Layout<D>& layout, const Block<D>& block, int threads, const Each& each,
                     std::int64_t grain = kRowsOfTask) {
  parallel_for(
      block.rows(), grain,
      [&](std::int64_t first, std::int64_t last) {
        std::array<int, D> cell = block.row(first);
        for (std::int64_t r = first; r < last; ++r) {
          const std::int64_t begin = layout.index(cell);
          each(std::as_const(cell), begin, begin + block.length());
          for (std::size_t a = D - 1; a-- > 0 && ++cell[a] == block.to[a];) cell[a] = block.from[a];
        }
      },
      threads);
}

// The same without the cell: each(begin, end).
template <int D, class Each>
void for_rows(const Layout<D>& layout, const Block<D>& block, int threads, const Each& each) {
  for_placed_rows(
      layout, block, threads,
      [&](const std::array<int, D>&, std::int64_t begin, std::int64_t end) { each(begin, end); });
}

// each(i) for all numbers of an array; `grain` of them are a task.
template <class Each>
void for_numbers(std::int64_t n, int threads, const Each& each,
                 std::int64_t grain = std::int64_t{1} << 15) {
  parallel_for(
      n, grain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) each(usize(i));
      },
      threads);
}

// n numbers of one value.
template <class T>
void assign(AlignedBuffer<T>& buffer, std::int64_t n, T value) {
  buffer.reset(usize(n));
  std::fill(buffer.begin(), buffer.end(), value);
}

template <class From, class To>
void copy(const From& from, To& to, int threads) {
  for_numbers(static_cast<std::int64_t>(from.size()), threads,
              [&](std::size_t i) { to[i] = from[i]; });
}

// What of_row(begin, end) returns, put together over rows in their order by add(total, part).
template <class T, int D, class OfRow, class Add>
T gather_rows(const Layout<D>& layout, const Block<D>& block, int threads, const T& none,
              const OfRow& of_row, const Add& add) {
  const std::int64_t rows = block.rows();
  std::vector<T> parts(usize((rows + kRowsOfTask - 1) / kRowsOfTask), none);
  parallel_for(
      rows, kRowsOfTask,
      [&](std::int64_t first, std::int64_t last) {
        T part = none;
        for (std::int64_t r = first; r < last; ++r) {
          const std::int64_t begin = layout.index(block.row(r));
          add(part, of_row(begin, begin + block.length()));
        }
        parts[usize(first / kRowsOfTask)] = part;
      },
      threads);
  T total = none;
  for (const T& part : parts) add(total, part);
  return total;
}

template <int D, class OfRow>
double sum_rows(const Layout<D>& layout, const Block<D>& block, int threads, const OfRow& of_row) {
  return gather_rows(layout, block, threads, 0.0, of_row,
                     [](double& total, double part) { total += part; });
}

// The first number from begin to below end that is not finite, or -1; and what joins those of rows.
template <class Numbers>
std::int64_t first_wrong(const Numbers& x, std::int64_t begin, std::int64_t end) {
  using Real = std::remove_cvref_t<decltype(x[0])>;
  int wrong = 0;  // not a bool, so that the loop is one of vectors
  for (std::int64_t i = begin; i < end; ++i) {
    wrong |= std::abs(x[usize(i)]) <= std::numeric_limits<Real>::max() ? 0 : 1;
  }
  if (wrong == 0) return -1;
  while (std::isfinite(x[usize(begin)])) ++begin;
  return begin;
}
inline void keep_first(std::int64_t& total, std::int64_t part) {
  if (total < 0) total = part;
}

}  // namespace substep::gridfluid
