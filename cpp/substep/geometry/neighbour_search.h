// Neighbours (neighbours.h) of points of either precision, in the order in which they came.
#pragma once

#include <cstdint>
#include <memory>

#include "substep/core/numbers.h"

namespace substep::geometry {

class NeighbourSearch {
 public:
  virtual ~NeighbourSearch() = default;
  virtual void search(double radius, int threads) = 0;
  // Of the last search.
  virtual std::int64_t bytes() const = 0;
  virtual std::int64_t pair_count() const = 0;
  // See neighbour_rows.h; half: only the j > i.
  virtual void count_rows(bool half, std::int64_t* offsets, int threads) const = 0;
  virtual void write_rows(bool half, const std::int64_t* offsets, std::int32_t* indices,
                          int threads) const = 0;
};

// Rows of two or three numbers.
std::unique_ptr<NeighbourSearch> make_neighbour_search(NumbersIn points, int columns);

}  // namespace substep::geometry
