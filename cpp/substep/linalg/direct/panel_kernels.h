// Dense kernels of the sparse Cholesky factorization, on panels: rows of a matrix as many as a
// cache line has numbers, column after column (entry (r, c) of a panel at kPanel c + r). Sums run
// over k = 0, 1, ... with fused multiply-adds where the machine has them.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <type_traits>

namespace substep {

template <class Real>
inline constexpr std::int64_t kPanelRows = 64 / static_cast<std::int64_t>(sizeof(Real));

template <class Real>
using PanelPacket = typename Eigen::internal::packet_traits<Real>::type;
template <class Real>
inline constexpr int kWidth = Eigen::internal::packet_traits<Real>::size;
template <class Real>
inline constexpr int kPackets = static_cast<int>(kPanelRows<Real>) / kWidth<Real>;  // of a column
// Columns that a pass of multiply_panels computes, such that its sums stay in registers.
template <class Real>
inline constexpr int kColumns = kPackets<Real> == 1   ? 8
                                : kPackets<Real> == 2 ? 4
                                                      : 2;

// C[p] -= A[p] B^T for kRows panels p: A[p] and B have k columns (the rows of B are the columns of
// C); C[p] has `columns` <= kPanel of them, and with kFirst it is C[p] = -A[p] B^T.
template <int kRows, bool kFirst, class Real>
void multiply_panels(const Real* const* a, const Real* b, std::int64_t k, Real* const* c,
                     std::int64_t columns) {
  using namespace Eigen::internal;
  constexpr std::int64_t kPanel = kPanelRows<Real>;
  constexpr int kSums = kColumns<Real>;
  for (int j0 = 0; j0 < columns; j0 += kSums) {
    for (int part = 0; part < kPackets<Real>; ++part) {
      const int r0 = part * kWidth<Real>;
      PanelPacket<Real> sums[kRows][kSums];
      for (int p = 0; p < kRows; ++p) {
        for (int j = 0; j < kSums; ++j) sums[p][j] = pset1<PanelPacket<Real>>(Real(0));
      }
      for (std::int64_t l = 0; l < k; ++l) {
        PanelPacket<Real> left[kRows];
        for (int p = 0; p < kRows; ++p) left[p] = ploadu<PanelPacket<Real>>(a[p] + kPanel * l + r0);
        for (int j = 0; j < kSums; ++j) {
          const auto right = pset1<PanelPacket<Real>>(b[kPanel * l + j0 + j]);
          for (int p = 0; p < kRows; ++p) sums[p][j] = pmadd(left[p], right, sums[p][j]);
        }
      }
      for (int p = 0; p < kRows; ++p) {
        for (int j = 0; j < kSums && j0 + j < columns; ++j) {
          Real* entry = c[p] + kPanel * (j0 + j) + r0;
          const auto before =
              kFirst ? pset1<PanelPacket<Real>>(Real(0)) : ploadu<PanelPacket<Real>>(entry);
          pstoreu(entry, psub(before, sums[p][j]));
        }
      }
    }
  }
}

// Factorizes the lower triangle of a w x w block (w <= kPanel) in place, whose upper triangle gets
// numbers without meaning; 1 / L_jj into `inverse`. Returns the first column whose pivot is not
// positive, or w.
template <class Real>
std::int64_t factorize_block(Real* block, std::int64_t w, Real* inverse) {
  using namespace Eigen::internal;
  constexpr std::int64_t kPanel = kPanelRows<Real>;
  for (std::int64_t j = 0; j < w; ++j) {
    Real* column = block + kPanel * j;
    const Real pivot = column[j];
    if (!(pivot > Real(0)) || !std::isfinite(pivot)) return j;
    const Real root = std::sqrt(pivot);
    inverse[j] = Real(1) / root;
    for (int r0 = 0; r0 < kPanel; r0 += kWidth<Real>) {
      const auto scaled =
          pmul(ploadu<PanelPacket<Real>>(column + r0), pset1<PanelPacket<Real>>(inverse[j]));
      pstoreu(column + r0, scaled);
    }
    column[j] = root;
    for (std::int64_t k = j + 1; k < w; ++k) {
      Real* later = block + kPanel * k;
      const auto factor = pset1<PanelPacket<Real>>(-column[k]);
      for (int r0 = 0; r0 < kPanel; r0 += kWidth<Real>) {
        pstoreu(later + r0, pmadd(ploadu<PanelPacket<Real>>(column + r0), factor,
                                  ploadu<PanelPacket<Real>>(later + r0)));
      }
    }
  }
  return w;
}

// X <- X L^-T for the rows X of a panel, w columns, and a factorized w x w block.
template <class Real>
void solve_panel(Real* x, const Real* block, const Real* inverse, std::int64_t w) {
  using namespace Eigen::internal;
  constexpr std::int64_t kPanel = kPanelRows<Real>;
  const auto solve = [&](auto full, Real* rows) {
    const std::int64_t width = full.value ? kPanel : w;
    PanelPacket<Real> columns[kPanel];
    for (std::int64_t j = 0; j < width; ++j)
      columns[j] = ploadu<PanelPacket<Real>>(rows + kPanel * j);
    for (std::int64_t j = 0; j < width; ++j) {
      columns[j] = pmul(columns[j], pset1<PanelPacket<Real>>(inverse[j]));
      const auto minus = pnegate(columns[j]);
      for (std::int64_t k = j + 1; k < width; ++k) {
        columns[k] = pmadd(minus, pset1<PanelPacket<Real>>(block[kPanel * j + k]), columns[k]);
      }
      pstoreu(rows + kPanel * j, columns[j]);
    }
  };
  for (int part = 0; part < kPackets<Real>; ++part) {
    if (w == kPanel) {
      solve(std::true_type{}, x + part * kWidth<Real>);
    } else {
      solve(std::false_type{}, x + part * kWidth<Real>);
    }
  }
}

}  // namespace substep
