// Which items each of so many rows has, row by row.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/usize.h"

namespace substep {

class Incidence {
 public:
  // each(visit) calls visit(row, item) for all items of all rows, the same ones each time. The last
  // item that it names of a row is the first of that row.
  template <class Each>
  void assign(std::int64_t rows, const Each& each) {
    first_.assign(usize(rows) + 1, 0);
    each([&](std::int32_t row, std::int32_t) { ++first_[usize(row)]; });
    std::int32_t sum = 0;
    for (std::int32_t& first : first_) first = sum += first;
    items_.resize(usize(sum));
    each([&](std::int32_t row, std::int32_t item) { items_[usize(--first_[usize(row)])] = item; });
  }

  std::span<const std::int32_t> of(std::int64_t row) const {
    const auto first = usize(first_[usize(row)]), end = usize(first_[usize(row) + 1]);
    return {items_.data() + first, end - first};
  }

 private:
  std::vector<std::int32_t> first_;  // of each row, in items_
  std::vector<std::int32_t> items_;  // row by row
};

}  // namespace substep
