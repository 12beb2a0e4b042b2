// The structure of a sparse Cholesky factor: a fill-reducing order of the vertices of a graph, the
// elimination tree, and supernodes (runs of columns with the same rows below them), merged where
// that adds few zeros (Ashcraft and Grimes, "The influence of relaxed supernode partitions on the
// multifrontal method", ACM TOMS 15 (1989) 291-309). Vertices stand for `block` rows of the matrix.
#pragma once

#include <cstdint>
#include <vector>

#include "substep/linalg/direct/cholesky.h"

namespace substep {

struct Supernodes {
  std::vector<std::int32_t> order;   // place in the factor -> vertex
  std::vector<std::int32_t> places;  // vertex -> place in the factor
  std::vector<std::int32_t> first;   // first column of each supernode; one entry more
  std::vector<std::int32_t> parent;  // -1: a root
  // Rows of supernode s, below its columns, sorted: [row_starts[s], row_starts[s + 1]).
  std::vector<std::int64_t> row_starts;
  std::vector<std::int32_t> rows;
  std::vector<std::int32_t> relative;  // the same rows' local index in the parent: columns, rows
  std::int64_t count() const { return static_cast<std::int64_t>(first.size()) - 1; }
  std::int32_t columns(std::int64_t s) const { return first[s + 1] - first[s]; }
  std::int64_t row_count(std::int64_t s) const { return row_starts[s + 1] - row_starts[s]; }
};

// Of a lower triangle. Ordering::automatic: metis from 5000 vertices on.
Supernodes find_supernodes(const SparsePattern& lower, std::int32_t block, Ordering ordering);

}  // namespace substep
