// Orders of elimination for symmetric matrices.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/linalg/direct/cholesky.h"

namespace substep {

// permutation[k] is the unknown eliminated k-th. With block > 1 the graph of the vertices is
// ordered, which has block^2 times fewer edges, and its order expanded. Throws std::bad_alloc.
std::vector<std::int32_t> elimination_order(const SparsePattern& lower, Ordering ordering,
                                            std::int32_t block);

}  // namespace substep
