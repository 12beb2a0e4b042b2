// The check before a factorization.
#pragma once

#include <cmath>
#include <complex>
#include <span>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/sparse.h"

namespace substep {

// Throws NonFiniteError that names the row and column of the first entry that is NaN or infinite.
template <class T>
void check_finite(const SparsePattern& pattern, std::span<const T> values) {
  T zero{};  // 0 * x is 0 for every finite x
  for (const T& value : values) zero += value * 0.0;
  if (std::abs(zero) == 0) return;
  for (std::size_t j = 0; j < usize(pattern.cols); ++j) {
    for (auto k = usize(pattern.start[j]); k < usize(pattern.start[j + 1]); ++k) {
      if (!std::isfinite(std::abs(values[k]))) {
        throw NonFiniteError("the matrix is not finite at row " + std::to_string(pattern.row[k]) +
                                 ", column " + std::to_string(j),
                             std::nan(""), pattern.row[k]);
      }
    }
  }
}

}  // namespace substep
