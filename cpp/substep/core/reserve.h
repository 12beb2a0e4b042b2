// Room in a vector ahead of changes that must not fail.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace substep {

// At least `size` in all; at least double of what there is, so that appending one by one stays
// linear in time.
template <class T, class Allocator>
void reserve_amortised(std::vector<T, Allocator>& rows, std::size_t size) {
  if (size > rows.capacity()) rows.reserve(std::max(size, 2 * rows.capacity()));
}

}  // namespace substep
