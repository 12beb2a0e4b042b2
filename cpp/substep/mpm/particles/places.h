// Where particles are in the order of their ids.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "substep/core/usize.h"

namespace substep::mpm {

// Places of some ids among them in ascending order: from a table of all ids that were ever given,
// or, where few of very many are left, by search.
class Places {
 public:
  static bool wants_table(std::int64_t next_id, std::int64_t count) {
    return next_id <= 8 * count + (1 << 16);
  }

  // 0 of each id that is there, else -1.
  static Places of_table(std::vector<std::int32_t> table) {
    Places places;
    for (std::size_t id = 0; id < table.size(); ++id) {
      if (table[id] < 0) continue;
      table[id] = static_cast<std::int32_t>(places.ids_.size());
      places.ids_.push_back(static_cast<std::int32_t>(id));
    }
    places.table_ = std::move(table);
    return places;
  }
  // In any order.
  static Places of_ids(std::vector<std::int32_t> ids) {
    Places places;
    std::sort(ids.begin(), ids.end());
    places.ids_ = std::move(ids);
    return places;
  }

  // Of an id, or -1.
  std::int32_t operator[](std::int32_t id) const {
    if (!table_.empty()) return table_[usize(id)];
    const auto at = std::lower_bound(ids_.begin(), ids_.end(), id);
    if (at == ids_.end() || *at != id) return -1;
    return static_cast<std::int32_t>(at - ids_.begin());
  }
  const std::vector<std::int32_t>& ids() const { return ids_; }  // ascending

 private:
  std::vector<std::int32_t> ids_, table_;
};

}  // namespace substep::mpm
