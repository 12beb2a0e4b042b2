#include "substep/linalg/sparse.h"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep {

std::int32_t SparsePattern::find(std::int32_t r, std::int32_t c) const {
  const auto begin = row.begin() + start[usize(c)];
  const auto end = row.begin() + start[usize(c) + 1];
  const auto at = std::lower_bound(begin, end, r);
  return at != end && *at == r ? static_cast<std::int32_t>(at - row.begin()) : -1;
}

void check_pattern(const SparsePattern& pattern) {
  const auto& [rows, cols, start, row] = pattern;
  if (rows < 0 || cols < 0 || start.size() != usize(cols) + 1 || start[0] != 0 ||
      start.back() < 0 || row.size() != usize(start.back())) {
    throw InputError("pattern: the column starts do not fit the shape and the row indices");
  }
  for (std::size_t j = 0; j < usize(cols); ++j) {
    if (start[j] > start[j + 1] || start[j + 1] > start.back()) {
      throw InputError("pattern: the column starts fall after column " + std::to_string(j));
    }
    for (auto k = usize(start[j]); k < usize(start[j + 1]); ++k) {
      if (row[k] < 0 || row[k] >= rows || (k > usize(start[j]) && row[k] <= row[k - 1])) {
        throw InputError("pattern: column " + std::to_string(j) + " holds row index " +
                         std::to_string(row[k]) + "; expected rows from 0 to " +
                         std::to_string(rows - 1) + " in ascending order");
      }
    }
  }
}

SparsePattern build_pattern(std::int32_t rows, std::int32_t cols,
                            std::span<const std::pair<std::int32_t, std::int32_t>> pairs,
                            std::vector<std::int32_t>* slots) {
  // Sorted by row, then stably by column: two counting sorts.
  const auto by = [&](auto key, std::int32_t count, const std::vector<std::size_t>& order) {
    std::vector<std::size_t> begin(usize(count) + 1, 0), sorted(order.size());
    for (const std::size_t k : order) {
      const std::int32_t value = key(pairs[k]);
      if (value < 0 || value >= count) throw InputError("pairs: index out of range");
      ++begin[usize(value) + 1];
    }
    for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
    for (const std::size_t k : order) sorted[begin[usize(key(pairs[k]))]++] = k;
    return sorted;
  };
  std::vector<std::size_t> order(pairs.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  order = by([](const auto& pair) { return pair.first; }, rows, order);
  order = by([](const auto& pair) { return pair.second; }, cols, order);
  SparsePattern pattern{rows, cols, std::vector<std::int32_t>(usize(cols) + 1), {}};
  if (slots) slots->resize(pairs.size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    const auto& [r, c] = pairs[order[k]];
    if (k == 0 || pairs[order[k - 1]] != pairs[order[k]]) {
      if (pattern.row.size() >= std::numeric_limits<std::int32_t>::max()) {
        throw InputError("pairs: the pattern exceeds 2**31 - 1 entries");
      }
      pattern.row.push_back(r);
      ++pattern.start[usize(c) + 1];
    }
    if (slots) (*slots)[order[k]] = static_cast<std::int32_t>(pattern.row.size()) - 1;
  }
  for (std::size_t j = 1; j < pattern.start.size(); ++j) pattern.start[j] += pattern.start[j - 1];
  return pattern;
}

SparsePattern expand_blocks(const SparsePattern& pattern, std::int32_t block, bool lower) {
  SparsePattern result{pattern.rows * block, pattern.cols * block, {0}, {}};
  const auto size = usize(block);
  result.row.reserve(pattern.row.size() * size * size);
  result.start.reserve(usize(result.cols) + 1);
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    for (std::int32_t c = 0; c < block; ++c) {
      for (auto k = pattern.start[usize(j)]; k < pattern.start[usize(j) + 1]; ++k) {
        const std::int32_t i = pattern.row[usize(k)];
        for (std::int32_t r = lower && i == j ? c : 0; r < block; ++r) {
          result.row.push_back(i * block + r);
        }
      }
      if (result.row.size() > std::numeric_limits<std::int32_t>::max()) {
        throw InputError("pattern: the expanded pattern exceeds 2**31 - 1 entries");
      }
      result.start.push_back(static_cast<std::int32_t>(result.row.size()));
    }
  }
  return result;
}

SparsePattern transposed(const SparsePattern& pattern, std::vector<std::int32_t>* entry) {
  SparsePattern result{pattern.cols, pattern.rows,
                       std::vector<std::int32_t>(usize(pattern.rows) + 1, 0),
                       std::vector<std::int32_t>(pattern.row.size())};
  for (const std::int32_t r : pattern.row) ++result.start[usize(r) + 1];
  for (std::size_t i = 1; i < result.start.size(); ++i) result.start[i] += result.start[i - 1];
  if (entry) entry->resize(pattern.row.size());
  std::vector<std::int32_t> next(result.start.begin(), result.start.end() - 1);
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    for (auto k = pattern.start[usize(j)]; k < pattern.start[usize(j) + 1]; ++k) {
      const auto at = usize(next[usize(pattern.row[usize(k)])]++);
      result.row[at] = j;
      if (entry) (*entry)[at] = k;
    }
  }
  return result;
}

bool is_lower(const SparsePattern& pattern) {
  for (std::size_t j = 0; j < usize(pattern.cols); ++j) {
    const auto first = pattern.start[j];
    if (first < pattern.start[j + 1] && pattern.row[usize(first)] < static_cast<std::int32_t>(j)) {
      return false;
    }
  }
  return true;
}

SparsePattern lower_triangle(const SparsePattern& pattern, std::vector<std::int32_t>* entry) {
  SparsePattern result{pattern.rows, pattern.cols, {0}, {}};
  if (entry) entry->clear();
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    for (auto k = pattern.start[usize(j)]; k < pattern.start[usize(j) + 1]; ++k) {
      if (pattern.row[usize(k)] < j) continue;
      result.row.push_back(pattern.row[usize(k)]);
      if (entry) entry->push_back(k);
    }
    result.start.push_back(static_cast<std::int32_t>(result.row.size()));
  }
  return result;
}

std::int32_t find_asymmetry(const SparsePattern& pattern, std::span<const double> values,
                            double tolerance) {
  double largest = 0, worst = 0;
  for (const double value : values) largest = std::max(largest, std::abs(value));
  std::int32_t found = -1;
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    for (auto k = pattern.start[usize(j)]; k < pattern.start[usize(j) + 1]; ++k) {
      const std::int32_t mirror = pattern.find(j, pattern.row[usize(k)]);
      const double difference =
          std::abs(values[usize(k)] - (mirror < 0 ? 0 : values[usize(mirror)]));
      if (difference > worst && difference > tolerance * largest) worst = difference, found = k;
    }
  }
  return found;
}

template <class T>
void multiply_transposed(const SparsePattern& pattern, std::span<const T> values,
                         std::span<const T> x, std::span<T> y, int threads) {
  const std::int32_t* const row = pattern.row.data();
  parallel_for(
      pattern.cols, 4096,
      [&](std::int64_t begin, std::int64_t end) {
        for (auto j = usize(begin); j < usize(end); ++j) {
          T sum{};
          for (auto k = usize(pattern.start[j]); k < usize(pattern.start[j + 1]); ++k) {
            sum += values[k] * x[usize(row[k])];
          }
          y[j] = sum;
        }
      },
      threads);
}

template void multiply_transposed(const SparsePattern&, std::span<const double>,
                                  std::span<const double>, std::span<double>, int);
template void multiply_transposed(const SparsePattern&, std::span<const std::complex<double>>,
                                  std::span<const std::complex<double>>,
                                  std::span<std::complex<double>>, int);

}  // namespace substep
