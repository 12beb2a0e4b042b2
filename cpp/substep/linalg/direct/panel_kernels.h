// Dense kernels of the sparse Cholesky factorization, on panels: eight rows of a matrix, column
// after column (entry (r, c) of a panel at 8 c + r). Sums run over k = 0, 1, ... with fused
// multiply-adds where the machine has them.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

namespace substep {

inline constexpr std::int64_t kPanel = 8;

using Packet = Eigen::internal::packet_traits<double>::type;
inline constexpr int kWidth = Eigen::internal::packet_traits<double>::size;
inline constexpr int kPackets = static_cast<int>(kPanel) / kWidth;  // of a column of a panel
// Columns that a pass of multiply_panels computes, such that its sums stay in registers.
inline constexpr int kColumns = kWidth == 8 ? 8 : kWidth == 4 ? 4 : 2;

// C[p] -= A[p] B^T for kRows panels p: A[p] is 8 x k, B is 8 x k (its rows are the columns of C);
// C[p] has `columns` <= 8 columns.
template <int kRows>
void multiply_panels(const double* const* a, const double* b, std::int64_t k, double* const* c,
                     std::int64_t columns) {
  using namespace Eigen::internal;
  for (int j0 = 0; j0 < columns; j0 += kColumns) {
    for (int part = 0; part < kPackets; ++part) {
      const int r0 = part * kWidth;
      Packet sums[kRows][kColumns];
      for (int p = 0; p < kRows; ++p) {
        for (int j = 0; j < kColumns; ++j) sums[p][j] = pset1<Packet>(0.0);
      }
      for (std::int64_t l = 0; l < k; ++l) {
        Packet left[kRows];
        for (int p = 0; p < kRows; ++p) left[p] = ploadu<Packet>(a[p] + 8 * l + r0);
        for (int j = 0; j < kColumns; ++j) {
          const Packet right = pset1<Packet>(b[8 * l + j0 + j]);
          for (int p = 0; p < kRows; ++p) sums[p][j] = pmadd(left[p], right, sums[p][j]);
        }
      }
      for (int p = 0; p < kRows; ++p) {
        for (int j = 0; j < kColumns && j0 + j < columns; ++j) {
          double* entry = c[p] + 8 * (j0 + j) + r0;
          pstoreu(entry, psub(ploadu<Packet>(entry), sums[p][j]));
        }
      }
    }
  }
}

// Factorizes the lower triangle of a w x w block (w <= 8) in place; 1 / L_jj into `inverse`.
// Returns the first column whose pivot is not positive, or w.
inline std::int64_t factorize_block(double* block, std::int64_t w, double* inverse) {
  for (std::int64_t j = 0; j < w; ++j) {
    for (std::int64_t k = 0; k < j; ++k) {
      const double ljk = block[8 * k + j];
      for (std::int64_t r = j; r < w; ++r) block[8 * j + r] -= block[8 * k + r] * ljk;
    }
    const double pivot = block[8 * j + j];
    if (!(pivot > 0.0) || !std::isfinite(pivot)) return j;
    const double root = std::sqrt(pivot);
    inverse[j] = 1.0 / root;
    block[8 * j + j] = root;
    for (std::int64_t r = j + 1; r < w; ++r) block[8 * j + r] *= inverse[j];
  }
  return w;
}

// X <- X L^-T for the eight rows X of a panel, w columns, and a factorized w x w block.
inline void solve_panel(double* x, const double* block, const double* inverse, std::int64_t w) {
  using namespace Eigen::internal;
  for (int part = 0; part < kPackets; ++part) {
    double* rows = x + part * kWidth;
    for (std::int64_t j = 0; j < w; ++j) {
      Packet sum = ploadu<Packet>(rows + 8 * j);
      for (std::int64_t k = 0; k < j; ++k) {
        sum = psub(sum, pmul(ploadu<Packet>(rows + 8 * k), pset1<Packet>(block[8 * k + j])));
      }
      pstoreu(rows + 8 * j, pmul(sum, pset1<Packet>(inverse[j])));
    }
  }
}

}  // namespace substep
