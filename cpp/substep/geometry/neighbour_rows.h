// The lists of a neighbour search in the order in which the points came: compressed sparse rows.
#pragma once

#include <cstdint>

#include "substep/geometry/neighbours.h"

namespace substep::geometry {

// offsets[i] .. offsets[i + 1]: where the row of point i (before the sort) will lie; n + 1 numbers.
// near: after sort() and find() of full lists. Half: only the j > i, by the indices before the
// sort.
template <class Real>
void count_rows(const Neighbours<Real>& near, Pairs pairs, std::int64_t* offsets, int threads);

// The rows at those offsets, each in cell order.
template <class Real>
void write_rows(const Neighbours<Real>& near, Pairs pairs, const std::int64_t* offsets,
                std::int32_t* indices, int threads);

}  // namespace substep::geometry
