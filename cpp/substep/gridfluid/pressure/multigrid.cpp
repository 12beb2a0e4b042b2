#include "substep/gridfluid/pressure/multigrid.h"

#include "substep/core/errors.h"

namespace substep::gridfluid {
namespace {

constexpr double kDamping = 0.8;

}  // namespace

template <class Real, int D>
Multigrid<Real, D>::Multigrid(const Layout<D>& layout) {
  std::array<int, D> cells = layout.cells;
  for (std::size_t a = 0; a < D; ++a)
    if (layout.periodic[a] && cells[a] == 1)
      throw InputError("a periodic axis of a grid must have 2 cells or more, got 1");
  levels_.emplace_back(layout);
  while (*std::max_element(cells.begin(), cells.end()) > 1) {
    for (int& n : cells) n = (n + 1) / 2;
    levels_.emplace_back(Layout<D>(cells, layout.periodic));
  }
  for (std::size_t l = 0; l < levels_.size(); ++l) {
    Level& level = levels_[l];
    const auto make = [&](AlignedBuffer<Real>& buffer) {
      buffer.reset(usize(level.layout.size));
      std::fill(buffer.begin(), buffer.end(), Real(0));
    };
    make(level.inverse_diagonal);
    for (std::size_t a = 0; a < D; ++a) {
      const int n = level.layout.cells[a];
      level.odd = level.odd || (level.layout.periodic[a] && n > 1 && n % 2 == 1);
    }
    if (l == 0) continue;
    make(level.own_b), make(level.own_x), make(level.own_r);
    level.b = level.own_b.data(), level.x = level.own_x.data(), level.r = level.own_r.data();
    for (std::size_t a = 0; a < D; ++a) {
      make(level.own_w[a]);
      level.w[a] = level.own_w[a].data();
      for (std::size_t side : {0, 1}) {
        make(level.lean[a][side]), make(level.loss[a][side]), make(level.own_air[a][side]);
      }
    }
  }
}

template <class Real, int D>
std::size_t Multigrid<Real, D>::bytes() const {
  std::size_t sum = 0;
  for (const Level& level : levels_) {
    sum += level.inverse_diagonal.bytes() + level.own_r.bytes() + level.own_b.bytes() +
           level.own_x.bytes();
    for (std::size_t a = 0; a < D; ++a) {
      sum += level.own_w[a].bytes();
      for (std::size_t side : {0, 1})
        sum += level.lean[a][side].bytes() + level.loss[a][side].bytes() +
               level.own_air[a][side].bytes();
    }
  }
  return sum;
}

namespace {

// The sum of w x over the neighbours of cells of a row: use(i, sum).
template <class Real, int D, class Level, class Use>
void for_sums(const Level& level, const Row<D>& row, const Use& use) {
  const std::int64_t at = row.at;
  const Real *const x = level.x + at, *const w = level.w[D - 1] + at;
  const Real *const x0 = level.x + row.below[0], *const x1 = level.x + row.above[0];
  const Real *const w0 = level.w[0] + at, *const w1 = level.w[0] + row.above[0];
  if constexpr (D == 2) {
#pragma GCC ivdep
    for (int i = 0; i < row.length; ++i)
      use(i, w[i] * x[i - 1] + w[i + 1] * x[i + 1] + w0[i] * x0[i] + w1[i] * x1[i]);
  } else {
    const Real *const y0 = level.x + row.below[1], *const y1 = level.x + row.above[1];
    const Real *const v0 = level.w[1] + at, *const v1 = level.w[1] + row.above[1];
#pragma GCC ivdep
    for (int i = 0; i < row.length; ++i)
      use(i, w[i] * x[i - 1] + w[i + 1] * x[i + 1] + w0[i] * x0[i] + w1[i] * x1[i] + v0[i] * y0[i] +
                 v1[i] * y1[i]);
  }
}

// Gauss-Seidel for the cells of one colour of a row. (Lanes of the other colour, which the sums
// read, keep what they have.)
template <class Real, int D, class Level>
void relax(const Level& level, const Row<D>& row, int colour) {
  Real* const x = level.x + row.at;
  const Real *const b = level.b + row.at, *const inverse = level.inverse_diagonal.data() + row.at;
  const int skip = (row.parity ^ colour) & 1;
  for_sums<Real>(level, row, [&](int i, Real sum) {
    x[i] = ((i ^ skip) & 1) ? x[i] : (b[i] + sum) * inverse[i];
  });
  wrap_row(level.layout, row, level.x);
}

// r after one sweep from x = 0 on: nothing for black cells, which were last; and red cells had
// x = b / diagonal.
template <class Real, int D, class Level>
void find_first_residual(const Level& level, const Row<D>& row) {
  Real* const r = level.r + row.at;
  const Real* const inverse = level.inverse_diagonal.data() + row.at;
  for_sums<Real>(level, row, [&](int i, Real sum) {
    r[i] = !((i ^ row.parity) & 1) && inverse[i] > 0 ? sum : 0;
  });
}

template <class Real, int D, class Level>
void find_residual(const Level& level, const Row<D>& row) {
  const Real* const x = level.x + row.at;
  Real* const r = level.r + row.at;
  const Real *const b = level.b + row.at, *const inverse = level.inverse_diagonal.data() + row.at;
  for_sums<Real>(level, row, [&](int i, Real sum) {
    r[i] = inverse[i] > 0 ? b[i] + sum - x[i] / inverse[i] : 0;
  });
}

// x += a damped step of Jacobi's iteration.
template <class Real, int D, class Level>
void add_damped(const Level& level, const Row<D>& row) {
  Real* const x = level.x + row.at;
  const Real *const r = level.r + row.at, *const inverse = level.inverse_diagonal.data() + row.at;
  for (int i = 0; i < row.length; ++i) x[i] += Real(kDamping) * inverse[i] * r[i];
  wrap_row(level.layout, row, level.x);
}

// P^T r.
template <class Real, int D, class Level>
void restrict_row(const Level& fine, Level& coarse, int plane, const Row<D>& row, int j) {
  const Layout<D>&of = fine.layout, &to = coarse.layout;
  const Real* const r = fine.r;
  // Fine rows of the aggregates of a coarse row.
  const auto fine_row = [&](int k, int jj, int dk, int dj) {
    std::int64_t at = of.first + (2 * k + dk) * of.stride[0] + 2 * row.begin;
    if constexpr (D == 3) at += (2 * jj + dj) * of.stride[1];
    return r + at;
  };
  constexpr int kJ = D == 3 ? 2 : 1;
  Real* const b = coarse.own_b.data() + row.at;
  const auto weight = [&](const auto& of_side, std::size_t a, std::size_t side, std::int64_t at) {
    return of_side[a][side].data() + at;
  };
  // The sums of one fine row, twice as long.
  for (int i = 0; i < row.length; ++i) b[i] = 0;
  for (int dk = 0; dk < 2; ++dk) {
    if (2 * plane + dk >= of.cells[0]) continue;
    const Real* const loss0 = weight(coarse.loss, 0, usize(dk), row.at);
    for (int dj = 0; dj < kJ; ++dj) {
      if constexpr (D == 3)
        if (2 * j + dj >= of.cells[1]) continue;
      const Real* const from = fine_row(plane, j, dk, dj);
      const Real *const lower = weight(coarse.loss, D - 1, 0, row.at), *const upper =
                                                                           weight(coarse.loss,
                                                                                  D - 1, 1, row.at);
      const Real* const loss1 = D == 3 ? weight(coarse.loss, 1, usize(dj), row.at) : nullptr;
      for (int i = 0; i < row.length; ++i) {
        const Real even = from[2 * i], odd = from[2 * i + 1];
        Real own = 1 - loss0[i];
        if constexpr (D == 3) own -= loss1[i];
        b[i] += (own - lower[i]) * even + (own - upper[i]) * odd;
      }
      // What leans on the neighbours in the row.
      const Real *const low = weight(coarse.lean, D - 1, 0, row.at), *const high =
                                                                         weight(coarse.lean, D - 1,
                                                                                1, row.at);
      const int n = row.length;
      for (int i = 0; i + 1 < n; ++i) b[i] += low[i + 1] * from[2 * i + 2];
      for (int i = 1; i < n; ++i) b[i] += high[i - 1] * from[2 * i - 1];
      if (to.periodic[D - 1] && n > 1) {
        b[n - 1] += low[0] * from[0];
        b[0] += high[n - 1] * (2 * n <= of.cells[D - 1] ? from[2 * n - 1] : Real(0));
      }
    }
  }
  const auto add = [&](const Real* lean, const Real* from) {
    for (int i = 0; i < row.length; ++i) b[i] += lean[i] * (from[2 * i] + from[2 * i + 1]);
  };
  const int nk = to.cells[0];
  for (int side = 0; side < 2; ++side) {  // of the neighbour, that on our side
    int k = plane + (side ? -1 : 1);
    if (k < 0 || k >= nk) {
      if (!to.periodic[0] || nk == 1) continue;
      k = (k + nk) % nk;
    }
    if (2 * k + side >= of.cells[0]) continue;
    const std::int64_t at = side ? row.below[0] : row.above[0];
    for (int dj = 0; dj < kJ; ++dj) {
      if constexpr (D == 3)
        if (2 * j + dj >= of.cells[1]) continue;
      add(weight(coarse.lean, 0, usize(side), at), fine_row(k, j, side, dj));
    }
  }
  if constexpr (D == 3) {
    const int nj = to.cells[1];
    for (int side = 0; side < 2; ++side) {
      int jj = j + (side ? -1 : 1);
      if (jj < 0 || jj >= nj) {
        if (!to.periodic[1] || nj == 1) continue;
        jj = (jj + nj) % nj;
      }
      if (2 * jj + side >= of.cells[1]) continue;
      const std::int64_t at = side ? row.below[1] : row.above[1];
      for (int dk = 0; dk < 2; ++dk) {
        if (2 * plane + dk >= of.cells[0]) continue;
        add(weight(coarse.lean, 1, usize(side), at), fine_row(plane, jj, dk, side));
      }
    }
  }
}

// x += P of what was found on the coarser level, for cells 2 i + parity.
template <class Real, int D, class Level>
void prolong(const Level& fine, const Level& coarse, int plane, const Row<D>& row, int j,
             int parity) {
  const Layout<D>& to = coarse.layout;
  const int sk = plane & 1, sj = j & 1, K = plane / 2, J = j / 2;
  std::int64_t at = to.first + K * to.stride[0] + row.begin / 2;
  if constexpr (D == 3) at += J * to.stride[1];
  const auto beside = [&](std::size_t a, int index, int side) {
    const int n = to.cells[a];
    if (to.periodic[a] && side == 0 && index == 0) return at + (n - 1) * to.stride[a];
    if (to.periodic[a] && side == 1 && index == n - 1) return at - (n - 1) * to.stride[a];
    return at + (side ? 1 : -1) * to.stride[a];
  };
  const Real* const e = coarse.x + at;
  const Real* const e0 = coarse.x + beside(0, K, sk);
  const Real *const lean0 = coarse.lean[0][usize(sk)].data() + at,
                    *const loss0 = coarse.loss[0][usize(sk)].data() + at;
  const Real *const lean2 = coarse.lean[D - 1][usize(parity)].data() + at,
                    *const loss2 = coarse.loss[D - 1][usize(parity)].data() + at;
  const Real* const e2 = e + (parity ? 1 : -1);
  Real* const x = fine.x + row.at + parity;
  const Real* const inverse = fine.inverse_diagonal.data() + row.at + parity;
  const int n = (row.length - parity + 1) / 2;
  if constexpr (D == 2) {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
      const Real v = e[i] * (1 - loss0[i] - loss2[i]) + lean0[i] * e0[i] + lean2[i] * e2[i];
      x[2 * i] += inverse[2 * i] > 0 ? v : 0;
    }
  } else {
    const Real* const e1 = coarse.x + beside(1, J, sj);
    const Real *const lean1 = coarse.lean[1][usize(sj)].data() + at,
                      *const loss1 = coarse.loss[1][usize(sj)].data() + at;
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) {
      const Real v = e[i] * (1 - loss0[i] - loss1[i] - loss2[i]) + lean0[i] * e0[i] +
                     lean1[i] * e1[i] + lean2[i] * e2[i];
      x[2 * i] += inverse[2 * i] > 0 ? v : 0;
    }
  }
  wrap_row(fine.layout, row, fine.x);
}

}  // namespace

template <class Real, int D>
void Multigrid<Real, D>::precondition(std::span<const Real> r, std::span<Real> z,
                                      std::span<Real> scratch, int threads) {
  levels_[0].b = r.data(), levels_[0].x = z.data(), levels_[0].r = scratch.data();
  cycle(0, threads);
}

// From x = 0 on: red cells, then black ones; and r.
template <class Real, int D>
void Multigrid<Real, D>::smooth_before(Level& level, int threads) {
  const auto start = [&](const Row<D>& row, Real factor, bool all) {
    Real* const x = level.x + row.at;
    const Real *const b = level.b + row.at, *const inverse = level.inverse_diagonal.data() + row.at;
    for (int i = 0; i < row.length; ++i)
      x[i] = all || !((i ^ row.parity) & 1) ? factor * b[i] * inverse[i] : 0;
    wrap_row(level.layout, row, level.x);
  };
  if (level.odd) {
    for_planes_in_stages<4>(
        level.fluid,
        [&](int stage, int plane) {
          for_rows(level.fluid, plane, [&](const Row<D>& row) {
            if (stage == 0) start(row, Real(kDamping), true);
            if (stage == 2) add_damped<Real>(level, row);
            if (stage == 1 || stage == 3) find_residual<Real>(level, row);
          });
        },
        threads);
    return;
  }
  for_planes_in_stages<3>(
      level.fluid,
      [&](int stage, int plane) {
        for_rows(level.fluid, plane, [&](const Row<D>& row) {
          if (stage == 0) start(row, 1, false);
          if (stage == 1) relax<Real>(level, row, 1);
          if (stage == 2) find_first_residual<Real>(level, row);
        });
      },
      threads);
}

// x += P e; then black cells, then red ones. (So black ones need no P e.)
template <class Real, int D>
void Multigrid<Real, D>::smooth_after(Level& level, const Level& coarse, int threads) {
  const auto correct = [&](int plane) {
    int j = 0;
    for_rows(level.fluid, plane, [&](const Row<D>& row) {
      prolong<Real, D>(level, coarse, plane, row, j, row.parity);
      if (level.odd) prolong<Real, D>(level, coarse, plane, row, j, 1 - row.parity);
      ++j;
    });
  };
  if (level.odd) {
    for_planes_in_stages<5>(
        level.fluid,
        [&](int stage, int plane) {
          if (stage == 0) return correct(plane);
          for_rows(level.fluid, plane, [&](const Row<D>& row) {
            if (stage == 1 || stage == 3) find_residual<Real>(level, row);
            if (stage == 2 || stage == 4) add_damped<Real>(level, row);
          });
        },
        threads);
    return;
  }
  for_planes_in_stages<3>(
      level.fluid,
      [&](int stage, int plane) {
        if (stage == 0) return correct(plane);
        for_rows(level.fluid, plane,
                 [&](const Row<D>& row) { relax<Real>(level, row, stage == 1); });
      },
      threads);
}

template <class Real, int D>
void Multigrid<Real, D>::cycle(std::size_t l, int threads) {
  Level& level = levels_[l];
  if (level.layout.count() < kSerial) threads = 1;
  smooth_before(level, threads);
  if (l + 1 == levels_.size()) return;
  Level& coarse = levels_[l + 1];
  for_slabs(
      coarse.fluid,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          int j = 0;
          for_rows(coarse.fluid, k,
                   [&](const Row<D>& row) { restrict_row<Real, D>(level, coarse, k, row, j++); });
        }
      },
      threads);
  cycle(l + 1, threads);
  smooth_after(level, coarse, threads);
}

template class Multigrid<float, 2>;
template class Multigrid<float, 3>;
template class Multigrid<double, 2>;
template class Multigrid<double, 3>;

}  // namespace substep::gridfluid
