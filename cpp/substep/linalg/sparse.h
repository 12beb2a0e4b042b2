// Sparse matrices in compressed columns: a pattern, which is analysed once, and its values, which
// change. Row indices are 32-bit and ascend within a column.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

namespace substep {

struct SparsePattern {
  std::int32_t rows = 0, cols = 0;
  std::vector<std::int32_t> start{0};  // column j holds the entries start[j] .. start[j + 1] - 1
  std::vector<std::int32_t> row;

  std::int32_t entries() const { return start.back(); }
  // The entry at (r, c); -1 where the pattern has none.
  std::int32_t find(std::int32_t r, std::int32_t c) const;
  bool operator==(const SparsePattern&) const = default;
};

// Throws InputError unless the arrays are a pattern as described above.
void check_pattern(const SparsePattern& pattern);

// The pattern of the (row, column) pairs, in any order and repeated at will. With `slots`, also the
// entry of each pair: so assembly is values[slot[k]] += contribution[k].
SparsePattern build_pattern(std::int32_t rows, std::int32_t cols,
                            std::span<const std::pair<std::int32_t, std::int32_t>> pairs,
                            std::vector<std::int32_t>* slots = nullptr);

// Each entry becomes a dense block x block square, each diagonal entry of a lower triangle
// (`lower`) the lower triangle of one: vertices to coordinates.
SparsePattern expand_blocks(const SparsePattern& pattern, std::int32_t block, bool lower);

// Rows become columns. With `entry`, entry k of the result is entry (*entry)[k] of `pattern`.
SparsePattern transposed(const SparsePattern& pattern, std::vector<std::int32_t>* entry = nullptr);

// Whether every column holds rows on or below the diagonal only.
bool is_lower(const SparsePattern& pattern);

// The entries on and below the diagonal. With `entry`, entry k of the result is entry (*entry)[k]
// of `pattern`.
SparsePattern lower_triangle(const SparsePattern& pattern,
                             std::vector<std::int32_t>* entry = nullptr);

// The entry that differs most from its mirror image, an absent one being zero; -1 where none does
// by more than `tolerance` times the largest entry.
std::int32_t find_asymmetry(const SparsePattern& pattern, std::span<const double> values,
                            double tolerance);

// y = A^T x: each y_j is a sum over column j in the order of its entries, whatever `threads`. For a
// symmetric matrix with both triangles stored it is A x.
template <class T>
void multiply_transposed(const SparsePattern& pattern, std::span<const T> values,
                         std::span<const T> x, std::span<T> y, int threads = 1);

}  // namespace substep
