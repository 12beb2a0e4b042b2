#include "substep/linalg/preconditioners.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <memory>

#include "substep/core/errors.h"
#include "substep/core/usize.h"
#include "substep/linalg/vectors.h"

namespace substep {

template <class T>
LinearOperator<T> diagonal_preconditioner(const SparsePattern& pattern, std::span<const T> values,
                                          int threads) {
  std::vector<T> inverse(usize(pattern.cols), T{1});
  for (std::int32_t j = 0; j < pattern.cols; ++j) {
    const std::int32_t k = pattern.find(j, j);
    if (k >= 0 && values[usize(k)] != T{}) inverse[usize(j)] = T{1} / values[usize(k)];
  }
  return [inverse = std::move(inverse), threads](std::span<const T> r, std::span<T> z) {
    for_each_index(r.size(), threads, [&](std::size_t i) { z[i] = inverse[i] * r[i]; });
  };
}

LinearOperator<double> block_diagonal_preconditioner(const SparsePattern& pattern,
                                                     std::span<const double> values,
                                                     std::int32_t block, bool lower, int threads) {
  if (block < 1 || pattern.cols % block != 0) {
    throw InputError("block: expected a divisor of the number of rows");
  }
  const std::size_t size = usize(block), blocks = usize(pattern.cols / block);
  std::vector<double> inverse(blocks * size * size);
  Eigen::MatrixXd square(block, block);
  for (std::size_t v = 0; v < blocks; ++v) {
    const auto first = static_cast<std::int32_t>(v) * block;
    for (std::int32_t c = 0; c < block; ++c) {
      for (std::int32_t r = 0; r < block; ++r) {
        const bool mirrored = lower && r < c;
        const std::int32_t k = pattern.find(first + (mirrored ? c : r), first + (mirrored ? r : c));
        square(r, c) = k < 0 ? 0 : values[usize(k)];
      }
    }
    const Eigen::FullPivLU<Eigen::MatrixXd> lu(square);
    Eigen::Map<Eigen::MatrixXd>(inverse.data() + v * size * size, block, block) =
        lu.isInvertible() ? Eigen::MatrixXd(lu.inverse()) : Eigen::MatrixXd::Identity(block, block);
  }
  return [inverse = std::move(inverse), size, threads](std::span<const double> r,
                                                       std::span<double> z) {
    for_each_index(r.size() / size, threads, [&](std::size_t v) {
      const double* const m = inverse.data() + v * size * size;
      for (std::size_t i = 0; i < size; ++i) {
        double sum = 0;
        for (std::size_t j = 0; j < size; ++j) sum += m[j * size + i] * r[v * size + j];
        z[v * size + i] = sum;
      }
    });
  };
}

namespace {

// Factorizes in place, column by column; the first column whose pivot is not positive, or -1.
std::int32_t factor_ic0(const SparsePattern& lower, std::vector<double>& l) {
  for (std::int32_t j = 0; j < lower.cols; ++j) {
    const auto begin = lower.start[usize(j)], end = lower.start[usize(j) + 1];
    if (begin == end || lower.row[usize(begin)] != j || !(l[usize(begin)] > 0)) return j;
    const double pivot = std::sqrt(l[usize(begin)]);
    l[usize(begin)] = pivot;
    for (auto k = begin + 1; k < end; ++k) l[usize(k)] /= pivot;
    for (auto k = begin + 1; k < end; ++k) {  // column i -= l_ij column j, where A has entries
      const std::int32_t i = lower.row[usize(k)];
      auto at = lower.start[usize(i)];
      const auto stop = lower.start[usize(i) + 1];
      for (auto m = k; m < end; ++m) {
        while (at < stop && lower.row[usize(at)] < lower.row[usize(m)]) ++at;
        if (at < stop && lower.row[usize(at)] == lower.row[usize(m)]) {
          l[usize(at)] -= l[usize(k)] * l[usize(m)];
        }
      }
    }
  }
  return -1;
}

struct Triangle {
  SparsePattern pattern;
  std::vector<double> values;
};

}  // namespace

LinearOperator<double> incomplete_cholesky(const SparsePattern& lower,
                                           std::span<const double> values) {
  auto factor = std::make_shared<Triangle>(Triangle{lower, {}});
  double shift = 0;
  for (;;) {
    factor->values.assign(values.begin(), values.end());
    for (std::int32_t j = 0; j < lower.cols; ++j) {
      const std::int32_t k = lower.find(j, j);
      if (k < 0) throw InputError("pattern: expected every diagonal entry");
      double& d = factor->values[usize(k)];
      d = d == 0 ? 1 : d + shift * std::abs(d);
    }
    if (factor_ic0(lower, factor->values) < 0) break;
    shift = shift == 0 ? 1e-3 : 2 * shift;
    if (!(shift < 1e6)) throw SingularMatrixError("no incomplete Cholesky factor exists");
  }
  return [factor](std::span<const double> r, std::span<double> z) {
    const auto& [p, l] = *factor;
    std::copy(r.begin(), r.end(), z.begin());
    for (std::int32_t j = 0; j < p.cols; ++j) {  // L y = r
      const auto begin = p.start[usize(j)], end = p.start[usize(j) + 1];
      const double y = z[usize(j)] /= l[usize(begin)];
      for (auto k = begin + 1; k < end; ++k) z[usize(p.row[usize(k)])] -= l[usize(k)] * y;
    }
    for (std::int32_t j = p.cols - 1; j >= 0; --j) {  // L^T z = y
      const auto begin = p.start[usize(j)], end = p.start[usize(j) + 1];
      double sum = z[usize(j)];
      for (auto k = begin + 1; k < end; ++k) sum -= l[usize(k)] * z[usize(p.row[usize(k)])];
      z[usize(j)] = sum / l[usize(begin)];
    }
  };
}

template <class T>
LinearOperator<T> incomplete_lu(const SparsePattern& pattern, std::span<const T> values) {
  struct Factor {
    SparsePattern rows;  // column i of it is row i of A
    std::vector<T> values;
    std::vector<std::int32_t> diagonal;
  };
  std::vector<std::int32_t> entry;
  auto factor = std::make_shared<Factor>(Factor{transposed(pattern, &entry), {}, {}});
  auto& [rows, lu, diagonal] = *factor;
  lu.reserve(entry.size());
  for (const std::int32_t k : entry) lu.push_back(values[usize(k)]);
  std::vector<std::int32_t> at(usize(rows.rows), -1);  // entry of the current row in each column
  for (std::int32_t i = 0; i < rows.cols; ++i) {
    const auto begin = rows.start[usize(i)], end = rows.start[usize(i) + 1];
    diagonal.push_back(rows.find(i, i));
    if (diagonal.back() < 0) throw InputError("pattern: expected every diagonal entry");
    for (auto k = begin; k < end; ++k) at[usize(rows.row[usize(k)])] = k;
    for (auto k = begin; k < end && rows.row[usize(k)] < i; ++k) {
      const std::int32_t j = rows.row[usize(k)];
      lu[usize(k)] /= lu[usize(diagonal[usize(j)])];
      for (auto m = diagonal[usize(j)] + 1; m < rows.start[usize(j) + 1]; ++m) {
        const std::int32_t to = at[usize(rows.row[usize(m)])];
        if (to >= 0) lu[usize(to)] -= lu[usize(k)] * lu[usize(m)];
      }
    }
    for (auto k = begin; k < end; ++k) at[usize(rows.row[usize(k)])] = -1;
    if (lu[usize(diagonal.back())] == T{}) lu[usize(diagonal.back())] = T{1};
  }
  return [factor](std::span<const T> r, std::span<T> z) {
    const auto& [p, f, d] = *factor;
    for (std::int32_t i = 0; i < p.cols; ++i) {  // L y = r
      T sum = r[usize(i)];
      for (auto k = p.start[usize(i)]; k < d[usize(i)]; ++k) {
        sum -= f[usize(k)] * z[usize(p.row[usize(k)])];
      }
      z[usize(i)] = sum;
    }
    for (std::int32_t i = p.cols - 1; i >= 0; --i) {  // U z = y
      T sum = z[usize(i)];
      for (auto k = d[usize(i)] + 1; k < p.start[usize(i) + 1]; ++k) {
        sum -= f[usize(k)] * z[usize(p.row[usize(k)])];
      }
      z[usize(i)] = sum / f[usize(d[usize(i)])];
    }
  };
}

using Complex = std::complex<double>;
template LinearOperator<double> diagonal_preconditioner(const SparsePattern&,
                                                        std::span<const double>, int);
template LinearOperator<Complex> diagonal_preconditioner(const SparsePattern&,
                                                         std::span<const Complex>, int);
template LinearOperator<double> incomplete_lu(const SparsePattern&, std::span<const double>);
template LinearOperator<Complex> incomplete_lu(const SparsePattern&, std::span<const Complex>);

}  // namespace substep
