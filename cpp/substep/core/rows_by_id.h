// The rows of what has ids, by ascending id.
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

#include "substep/core/usize.h"

namespace substep {

// ids: different ones, below next_id. From a table of all ids that were ever given, unless few of
// very many are left.
inline std::vector<std::size_t> rows_by_id(std::span<const std::int64_t> ids,
                                           std::int64_t next_id) {
  constexpr std::size_t kNone = ~std::size_t{0};
  if (next_id > 8 * static_cast<std::int64_t>(ids.size()) + (1 << 16)) {
    std::vector<std::size_t> row(ids.size());
    std::iota(row.begin(), row.end(), std::size_t{0});
    std::sort(row.begin(), row.end(),
              [&](std::size_t i, std::size_t j) { return ids[i] < ids[j]; });
    return row;
  }
  std::vector<std::size_t> row(usize(next_id), kNone);
  for (std::size_t i = 0; i < ids.size(); ++i) row[usize(ids[i])] = i;
  std::erase(row, kNone);
  return row;
}

}  // namespace substep
