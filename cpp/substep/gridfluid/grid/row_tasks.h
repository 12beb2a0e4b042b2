// Loops over the rows of a grid by several threads.
#pragma once

#include <algorithm>
#include <cstdint>

#include "substep/core/aligned_buffer.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

inline constexpr std::int64_t kRowsEach = 8;

// each(begin, end) of each row of cells, or of the faces of an axis.
template <int D, class Each>
void for_each_row(const Layout<D>& layout, int faces_of, int threads, const Each& each) {
  const int length = layout.row_length(faces_of);
  parallel_for(
      layout.rows(faces_of), kRowsEach,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t r = begin; r < end; ++r) {
          const std::int64_t row = layout.row(r, faces_of);
          each(row, row + length);
        }
      },
      threads);
}

// n numbers of one value.
template <class T>
void assign(AlignedBuffer<T>& buffer, std::int64_t n, T value) {
  buffer.reset(usize(n));
  std::fill(buffer.begin(), buffer.end(), value);
}

}  // namespace substep::gridfluid
