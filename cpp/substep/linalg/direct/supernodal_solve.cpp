// Triangular solves with a supernodal factor: forward from the leaves, where each front hands the
// sums for the rows below it on to its parent, and back from the roots.
#include <algorithm>
#include <type_traits>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/linalg/direct/panel_kernels.h"
#include "substep/linalg/direct/supernodal_front.h"

namespace substep {
namespace {

// Right-hand sides of a front lie side by side, kSides runs of numbers, padded to panels. A vertex
// has kRows rows: block = 1 has one and three sides, block = 3 has three, and one side or
// kTogether.
constexpr int kTogether = 3;

// y[rows of panel] += sign * L x for columns [0, k).
template <int kSides, class Real>
void multiply_columns(const Real* panel, std::int64_t k, const Real* x, std::int64_t x_stride,
                      Real* out, std::int64_t out_stride) {
  using namespace Eigen::internal;
  constexpr std::int64_t kPanel = kPanelRows<Real>;
  PanelPacket<Real> sums[kSides][kPackets<Real>][2];
  for (auto& side : sums) {
    for (auto& part : side) part[0] = part[1] = pset1<PanelPacket<Real>>(Real(0));
  }
  std::int64_t c = 0;
  for (; c + 2 <= k; c += 2) {
    for (int q = 0; q < 2; ++q) {
      for (int part = 0; part < kPackets<Real>; ++part) {
        const PanelPacket<Real> l =
            ploadu<PanelPacket<Real>>(panel + kPanel * (c + q) + part * kWidth<Real>);
        for (int side = 0; side < kSides; ++side) {
          sums[side][part][q] =
              pmadd(l, pset1<PanelPacket<Real>>(x[side * x_stride + c + q]), sums[side][part][q]);
        }
      }
    }
  }
  for (; c < k; ++c) {
    for (int part = 0; part < kPackets<Real>; ++part) {
      const PanelPacket<Real> l =
          ploadu<PanelPacket<Real>>(panel + kPanel * c + part * kWidth<Real>);
      for (int side = 0; side < kSides; ++side) {
        sums[side][part][0] =
            pmadd(l, pset1<PanelPacket<Real>>(x[side * x_stride + c]), sums[side][part][0]);
      }
    }
  }
  for (int side = 0; side < kSides; ++side) {
    for (int part = 0; part < kPackets<Real>; ++part) {
      Real* target = out + side * out_stride + part * kWidth<Real>;
      pstoreu(target, psub(ploadu<PanelPacket<Real>>(target),
                           padd(sums[side][part][0], sums[side][part][1])));
    }
  }
}

// t[j] -= sum over the rows of `count` panels of L_rj x_r, for eight columns j from `panel` on.
template <int kSides, class Real>
void multiply_transposed(const Real* panel, std::int64_t stride, std::int64_t count, const Real* x,
                         std::int64_t x_stride, std::int64_t width, Real* t,
                         std::int64_t t_stride) {
  using namespace Eigen::internal;
  constexpr std::int64_t kPanel = kPanelRows<Real>;
  for (std::int64_t j0 = 0; j0 < width; j0 += 4) {
    PanelPacket<Real> sums[kSides][4];
    for (auto& side : sums) {
      for (auto& sum : side) sum = pset1<PanelPacket<Real>>(Real(0));
    }
    const int columns = static_cast<int>(std::min<std::int64_t>(4, width - j0));
    const auto pass = [&](auto wide) {
      for (std::int64_t p = 0; p < count; ++p) {
        for (int part = 0; part < kPackets<Real>; ++part) {
          PanelPacket<Real> rows[kSides];
          for (int side = 0; side < kSides; ++side) {
            rows[side] =
                ploadu<PanelPacket<Real>>(x + side * x_stride + kPanel * p + part * kWidth<Real>);
          }
          const Real* l = panel + p * stride + kPanel * j0 + part * kWidth<Real>;
          for (int j = 0; j < 4; ++j) {
            if (!wide.value && j >= columns) break;
            const PanelPacket<Real> entries = ploadu<PanelPacket<Real>>(l + kPanel * j);
            for (int side = 0; side < kSides; ++side) {
              sums[side][j] = pmadd(entries, rows[side], sums[side][j]);
            }
          }
        }
      }
    };
    if (columns == 4) {
      pass(std::true_type{});
    } else {
      pass(std::false_type{});
    }
    for (int side = 0; side < kSides; ++side) {
      for (int j = 0; j < columns; ++j) t[side * t_stride + j0 + j] -= predux(sums[side][j]);
    }
  }
}

}  // namespace

template <class Real>
template <int kRows, int kSides>
void SupernodalCholesky<Real>::forward_front(std::int64_t s) {
  const Front& f = fronts_[s];
  const std::int64_t stride = kPanel * (f.pivots + f.below), below = kPanel * f.pivots;
  thread_local std::vector<Real> scratch;
  scratch.assign(usize(kSides * stride), Real(0));
  Real* y = scratch.data();
  constexpr int kNumbers = kRows * kSides;  // of a vertex
  Real* own = solution_.data() + kNumbers * tree_.first[s];
  for (std::int64_t r = 0; r < f.columns; ++r) {
    for (int side = 0; side < kSides; ++side) y[side * stride + r] = own[r * kSides + side];
  }
  const std::int64_t vertices = tree_.columns(s);
  for (const std::int32_t child : children_[s]) {
    const std::int32_t* relative = tree_.relative.data() + tree_.row_starts[child];
    const Real* u = updates_.data() + kNumbers * fronts_[child].update;
    for (std::int64_t k = 0; k < tree_.row_count(child); ++k) {
      const std::int64_t v = relative[k];
      Real* target = y + (v < vertices ? kRows * v : below + kRows * (v - vertices));
      for (int q = 0; q < kNumbers; ++q) {
        target[q % kSides * stride + q / kSides] += u[kNumbers * k + q];
      }
    }
  }
  const Real* columns = factor_.data() + f.factor;
  const Real* inverse = inverses_.data() + f.inverse;
  const std::int64_t panel = f.columns * kPanel;
  for (std::int64_t b = 0; b < f.pivots; ++b) {
    Real* rows = y + kPanel * b;
    multiply_columns<kSides>(columns + b * panel, kPanel * b, y, stride, rows, stride);
    const Real* block = columns + b * panel + kPanel * kPanel * b;
    const std::int64_t width = std::min(kPanel, f.columns - kPanel * b);
    for (int side = 0; side < kSides; ++side) {
      Real* x = rows + side * stride;
      for (std::int64_t j = 0; j < width; ++j) {
        x[j] *= inverse[kPanel * b + j];
        for (std::int64_t r = j + 1; r < width; ++r) x[r] -= block[kPanel * j + r] * x[j];
      }
    }
  }
  for (std::int64_t p = 0; p < f.below; ++p) {
    multiply_columns<kSides>(columns + (f.pivots + p) * panel, f.columns, y, stride,
                             y + below + kPanel * p, stride);
  }
  for (std::int64_t r = 0; r < f.columns; ++r) {
    for (int side = 0; side < kSides; ++side) own[r * kSides + side] = y[side * stride + r];
  }
  Real* u = updates_.data() + kNumbers * f.update;
  for (std::int64_t r = 0; r < f.rows; ++r) {
    for (int side = 0; side < kSides; ++side) u[r * kSides + side] = y[side * stride + below + r];
  }
}

template <class Real>
template <int kRows, int kSides>
void SupernodalCholesky<Real>::backward_front(std::int64_t s) {
  const Front& f = fronts_[s];
  const std::int64_t stride = kPanel * (f.pivots + f.below), below = kPanel * f.pivots;
  thread_local std::vector<Real> scratch;
  scratch.assign(usize(kSides * stride), Real(0));
  Real* x = scratch.data();
  constexpr int kNumbers = kRows * kSides;  // of a vertex
  Real* own = solution_.data() + kNumbers * tree_.first[s];
  for (std::int64_t r = 0; r < f.columns; ++r) {
    for (int side = 0; side < kSides; ++side) x[side * stride + r] = own[r * kSides + side];
  }
  const std::int32_t* rows = tree_.rows.data() + tree_.row_starts[s];
  for (std::int64_t k = 0; k < tree_.row_count(s); ++k) {
    const Real* source = solution_.data() + kNumbers * rows[k];
    Real* target = x + below + kRows * k;
    for (int q = 0; q < kNumbers; ++q) target[q % kSides * stride + q / kSides] = source[q];
  }
  const Real* columns = factor_.data() + f.factor;
  const Real* inverse = inverses_.data() + f.inverse;
  const std::int64_t panel = f.columns * kPanel;
  for (std::int64_t b = f.pivots - 1; b >= 0; --b) {
    const std::int64_t width = std::min(kPanel, f.columns - kPanel * b);
    Real* t = x + kPanel * b;
    const Real* block = columns + b * panel + kPanel * kPanel * b;
    multiply_transposed<kSides>(block + panel, panel, f.pivots + f.below - b - 1, t + kPanel,
                                stride, width, t, stride);
    for (int side = 0; side < kSides; ++side) {
      Real* y = t + side * stride;
      for (std::int64_t j = width - 1; j >= 0; --j) {
        y[j] *= inverse[kPanel * b + j];
        for (std::int64_t r = 0; r < j; ++r) y[r] -= block[kPanel * r + j] * y[j];
      }
    }
  }
  for (std::int64_t r = 0; r < f.columns; ++r) {
    for (int side = 0; side < kSides; ++side) own[r * kSides + side] = x[side * stride + r];
  }
}

template <class Real>
template <int kRows, int kSides>
void SupernodalCholesky<Real>::solve_sides(int threads) {
  const auto tasks = static_cast<std::int64_t>(task_roots_.size());
  parallel_chunks(
      tasks,
      [&](std::int64_t task) {
        for (std::int64_t s = task_first_[task]; s <= task_roots_[task]; ++s) {
          forward_front<kRows, kSides>(s);
        }
      },
      threads);
  for (const std::int64_t s : top_) forward_front<kRows, kSides>(s);
  for (auto s = top_.rbegin(); s != top_.rend(); ++s) backward_front<kRows, kSides>(*s);
  parallel_chunks(
      tasks,
      [&](std::int64_t task) {
        for (std::int64_t s = task_roots_[task]; s >= task_first_[task]; --s) {
          backward_front<kRows, kSides>(s);
        }
      },
      threads);
}

template <class Real>
void SupernodalCholesky<Real>::solve(std::span<double> x, int threads) {
  const std::size_t n = tree_.order.size();
  if (x.size() != 3 * n) throw InputError("x: expected three numbers for each vertex");
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t q = 0; q < 3; ++q) {
      solution_[3 * k + q] = static_cast<Real>(x[3 * tree_.order[k] + q]);
    }
  }
  if (block_ == 3) {
    solve_sides<3, 1>(threads);
  } else {
    solve_sides<1, 3>(threads);
  }
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t q = 0; q < 3; ++q) x[3 * tree_.order[k] + q] = solution_[3 * k + q];
  }
}

template <class Real>
void SupernodalCholesky<Real>::solve(std::span<std::vector<double>> x, int threads) {
  const std::size_t n = tree_.order.size();
  for (const std::vector<double>& side : x) {
    if (side.size() != 3 * n) throw InputError("x: expected three numbers for each vertex");
  }
  std::size_t first = 0;
  if (block_ == 3 && x.size() >= kTogether) {
    solution_.resize(kTogether * 3 * n);
    updates_.resize(kTogether * 3 * tree_.rows.size());
    for (; first + kTogether <= x.size(); first += kTogether) {
      const auto sides = x.subspan(first, kTogether);
      for (std::size_t k = 0; k < 3 * n; ++k) {
        const std::size_t from = 3 * usize(tree_.order[k / 3]) + k % 3;
        for (std::size_t side = 0; side < kTogether; ++side) {
          solution_[kTogether * k + side] = static_cast<Real>(sides[side][from]);
        }
      }
      solve_sides<3, kTogether>(threads);
      for (std::size_t k = 0; k < 3 * n; ++k) {
        const std::size_t to = 3 * usize(tree_.order[k / 3]) + k % 3;
        for (std::size_t side = 0; side < kTogether; ++side) {
          sides[side][to] = solution_[kTogether * k + side];
        }
      }
    }
  }
  for (; first < x.size(); ++first) solve(x[first], threads);
}

template void SupernodalCholesky<double>::solve(std::span<double> x, int threads);
template void SupernodalCholesky<float>::solve(std::span<double> x, int threads);
template void SupernodalCholesky<double>::solve(std::span<std::vector<double>> x, int threads);
template void SupernodalCholesky<float>::solve(std::span<std::vector<double>> x, int threads);

}  // namespace substep
