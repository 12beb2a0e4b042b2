#include "substep/gridfluid/multigrid.h"

#include <cstdlib>

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kSerial = 1 << 13;  // cells of a level that is not worth sharing

}  // namespace

template <class Real, int D>
Multigrid<Real, D>::Multigrid(const Layout<D>& layout) {
  std::array<int, D> cells = layout.cells;
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

template <class Real, int D>
void Multigrid<Real, D>::set_matrix(const Coefficients& w, std::span<const Cell> cells,
                                    int threads) {
  Level& finest = levels_[0];
  for (std::size_t a = 0; a < D; ++a) finest.w[a] = w[a].data();
  for_slabs(
      finest.layout,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k)
          for_rows(finest.layout, k, [&](const Row<D>& row) {
            for (std::int64_t i = 0; i < row.length; ++i) {
              Real sum = finest.w[D - 1][row.at + i] + finest.w[D - 1][row.at + i + 1];
              for (std::size_t a = 0; a < D - 1; ++a)
                sum += finest.w[a][row.at + i] + finest.w[a][row.above[a] + i];
              finest.inverse_diagonal[usize(row.at + i)] =
                  cells[usize(row.at + i)] == Cell::kFluid && sum > 0 ? 1 / sum : 0;
            }
          });
      },
      threads);
  for (std::size_t l = 1; l < levels_.size(); ++l) coarsen(levels_[l - 1], levels_[l], threads);
}

template <class Real, int D>
void Multigrid<Real, D>::coarsen(const Level& fine, Level& coarse, int threads) {
  const Layout<D>&of = fine.layout, &to = coarse.layout;
  const bool is_finest = &fine == levels_.data();
  const auto coarse_cell = [&](const std::array<int, D>& cell) {
    const std::int64_t at = to.index(cell);
    Real diagonal = 0;
    for (std::size_t a = 0; a < D; ++a) {
      const int n = of.cells[a];
      const auto inside = [&](int index) { return of.periodic[a] ? (index + n) % n : index; };
      for (int side = 0; side < 2; ++side) {
        // Along a column: `beside` the face, then `other`; beyond the face `across`, `behind`.
        const int lower = 2 * cell[a], upper = std::min(lower + 1, n - 1);
        const int beside = side ? upper : lower, other = side ? lower : upper;
        const bool single = lower == upper;
        const int beyond = inside(side ? upper + 1 : lower - 1);
        const int beyond_cell = beyond < 0 ? -1 : beyond / 2;
        int behind = beyond_cell < 0 || beyond >= n ? -2
                     : beyond % 2 == 0            ? beyond + 1
                                                  : beyond - 1;
        if (behind >= n) behind = -2;
        Real link = 0, air = 0, lean = 0, loss = 0, count = 0;
        for (int c = 0; c < 1 << (D - 1); ++c) {
          std::array<int, D> i = cell;
          bool exists = true;
          for (std::size_t e = 0, bit = 0; e < D; ++e) {
            if (e == a) continue;
            i[e] = 2 * cell[e] + ((c >> bit++) & 1);
            exists = exists && i[e] < of.cells[e];
          }
          if (!exists) continue;
          const auto index = [&](int along) {
            i[a] = along;
            return of.index(i);
          };
          const std::int64_t b = index(beside), o = index(other), x = index(beyond);
          const auto known = [&](std::int64_t cell_) {
            return fine.inverse_diagonal[usize(cell_)] > 0;
          };
          const auto face_of = [&](std::int64_t cell_, int along) {
            return side ? (of.periodic[a] && along == n - 1 ? index(0) : cell_ + of.stride[a])
                        : cell_;
          };
          // What joins a cell to air on this side.
          const auto air_of = [&](std::int64_t cell_, int along, std::int64_t next) {
            if (is_finest) return known(next) ? Real(0) : fine.w[a][face_of(cell_, along)];
            return fine.own_air[a][usize(side)][usize(cell_)];
          };
          if (!single && known(o)) air += air_of(o, other, b);
          if (!known(b)) continue;
          count += 1;
          const Real w_inner = single ? 0 : fine.w[a][std::max(b, o)];
          const Real half = !single && known(o) && w_inner > 0 ? Real(.5) / w_inner : 0;
          const Real w_air = air_of(b, beside, x);
          if (w_air > 0) {
            const Real k = 1 / (half + 1 / w_air);
            air += k, loss += half * k;
          }
          const Real w = fine.w[a][face_of(b, beside)];
          if (!(w > 0) || !known(x)) continue;
          Real far = 0;
          if (behind >= 0) {
            const std::int64_t h = index(behind);
            const Real w_far = fine.w[a][std::max(h, x)];
            if (known(h) && w_far > 0) far = Real(.5) / w_far;
          }
          const Real k = 1 / (half + 1 / w + far);
          link += k, lean += half * k, loss += half * k;
        }
        coarse.own_air[a][usize(side)][usize(at)] = air;
        if (to.periodic[a] && to.cells[a] == 1) link = lean = 0, loss = 0;
        diagonal += link + air;
        if (side == 0) coarse.own_w[a][usize(at)] = link;
        if (side == 1 && cell[a] == to.cells[a] - 1)
          coarse.own_w[a][usize(at + to.stride[a])] = link;
        const Real scale = count > 0 ? 1 / count : 0;
        coarse.lean[a][usize(side)][usize(at)] = lean * scale;
        coarse.loss[a][usize(side)][usize(at)] = loss * scale;
      }
    }
    coarse.inverse_diagonal[usize(at)] = diagonal > 0 ? 1 / diagonal : 0;
  };
  for_slabs(
      to,
      [&](std::int64_t, int begin, int end) {
        std::array<int, D> cell;
        for (cell[0] = begin; cell[0] < end; ++cell[0]) {
          for (cell[1] = 0; cell[1] < to.cells[1]; ++cell[1]) {
            if constexpr (D == 3) {
              for (cell[2] = 0; cell[2] < to.cells[2]; ++cell[2]) coarse_cell(cell);
            } else {
              coarse_cell(cell);
            }
          }
        }
      },
      to.count() < kSerial ? 1 : threads);
}

namespace {

// Gauss-Seidel for the cells of one colour of a row.
template <class Real, int D, class Level>
void relax(const Level& level, const Row<D>& row, int colour) {
  const std::int64_t at = row.at;
  Real* const x = level.x + at;
  const Real *const b = level.b + at, *const inverse = level.inverse_diagonal.data() + at;
  const Real* const w = level.w[D - 1] + at;
  const int skip = (row.parity ^ colour) & 1;
  const Real *const x0 = level.x + row.below[0], *const x1 = level.x + row.above[0];
  const Real *const w0 = level.w[0] + at, *const w1 = level.w[0] + row.above[0];
  if constexpr (D == 2) {
#pragma GCC ivdep
    for (int i = 0; i < row.length; ++i) {
      const Real v = b[i] + w[i] * x[i - 1] + w[i + 1] * x[i + 1] + w0[i] * x0[i] + w1[i] * x1[i];
      x[i] = ((i ^ skip) & 1) ? x[i] : v * inverse[i];
    }
  } else {
    const Real *const y0 = level.x + row.below[1], *const y1 = level.x + row.above[1];
    const Real *const v0 = level.w[1] + at, *const v1 = level.w[1] + row.above[1];
#pragma GCC ivdep
    for (int i = 0; i < row.length; ++i) {
      const Real v = b[i] + w[i] * x[i - 1] + w[i + 1] * x[i + 1] + w0[i] * x0[i] + w1[i] * x1[i] +
                     v0[i] * y0[i] + v1[i] * y1[i];
      x[i] = ((i ^ skip) & 1) ? x[i] : v * inverse[i];
    }
  }
  wrap_row(level.layout, row, level.x);
}

// r of a row, after the cells of `colour` were relaxed last.
template <class Real, int D, class Level>
void find_residual(Level& level, const Row<D>& row, int colour) {
  const std::int64_t at = row.at;
  const Real* const x = level.x + at;
  Real* const r = level.r + at;
  const Real *const b = level.b + at, *const inverse = level.inverse_diagonal.data() + at;
  const Real* const w = level.w[D - 1] + at;
  const int skip = (row.parity ^ colour) & 1;
  for (int i = 0; i < row.length; ++i) {
    Real v = b[i] + w[i] * x[i - 1] + w[i + 1] * x[i + 1];
    for (std::size_t a = 0; a < D - 1; ++a)
      v += level.w[a][at + i] * level.x[row.below[a] + i] +
           level.w[a][row.above[a] + i] * level.x[row.above[a] + i];
    r[i] = ((i ^ skip) & 1) && inverse[i] > 0 ? v - x[i] / inverse[i] : 0;
  }
}

// P^T r.
template <class Real, int D, class Level>
void restrict_row(const Level& fine, Level& coarse, int plane, const Row<D>& row, int j) {
  const Layout<D>&of = fine.layout, &to = coarse.layout;
  const Real* const r = fine.r;
  // Fine rows of the aggregates of a coarse row.
  const auto fine_row = [&](int k, int jj, int dk, int dj) {
    std::int64_t at = of.first + (2 * k + dk) * of.stride[0];
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
      const Real *const lower = weight(coarse.loss, D - 1, 0, row.at),
                        *const upper = weight(coarse.loss, D - 1, 1, row.at);
      const Real* const loss1 = D == 3 ? weight(coarse.loss, 1, usize(dj), row.at) : nullptr;
      for (int i = 0; i < row.length; ++i) {
        const Real even = from[2 * i], odd = from[2 * i + 1];
        Real own = 1 - loss0[i];
        if constexpr (D == 3) own -= loss1[i];
        b[i] += (own - lower[i]) * even + (own - upper[i]) * odd;
      }
      // What leans on the neighbours in the row.
      const Real *const low = weight(coarse.lean, D - 1, 0, row.at),
                        *const high = weight(coarse.lean, D - 1, 1, row.at);
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

// x += P of what was found on the coarser level, for the cells of colour 0.
template <class Real, int D, class Level>
void prolong(const Level& fine, const Level& coarse, int plane, const Row<D>& row, int j) {
  const Layout<D>& to = coarse.layout;
  const int sk = plane & 1, sj = j & 1, K = plane / 2, J = j / 2;
  std::int64_t at = to.first + K * to.stride[0];
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
  const int parity = row.parity;  // cells of colour 0 are 2 i + parity
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

static const int kSweeps = std::getenv("SWEEPS") ? std::atoi(std::getenv("SWEEPS")) : 1;
static const int kSweepsC = std::getenv("SWEEPSC") ? std::atoi(std::getenv("SWEEPSC")) : 1;

template <class Real, int D>
void Multigrid<Real, D>::cycle(std::size_t l, int threads) {
  Level& level = levels_[l];
  const Layout<D>& layout = level.layout;
  if (layout.count() < kSerial) threads = 1;
  const auto relax_plane = [&](int plane, int colour) {
    for_rows(layout, plane, [&](const Row<D>& row) { relax<Real, D>(level, row, colour); });
  };
  const auto first = [&](int plane) {
    for_rows(layout, plane, [&](const Row<D>& row) {
      Real* const x = level.x + row.at;
      const Real *const b = level.b + row.at,
                        *const inverse = level.inverse_diagonal.data() + row.at;
      for (int i = 0; i < row.length; ++i)
        x[i] = ((i ^ row.parity) & 1) ? Real(0) : b[i] * inverse[i];
      wrap_row(layout, row, level.x);
    });
  };
  const auto residual = [&](int plane) {
    for_rows(layout, plane, [&](const Row<D>& row) { find_residual<Real, D>(level, row, 1); });
  };
  if (l + 1 == levels_.size()) {
    for_planes_in_stages<1>(layout, [&](int, int plane) { first(plane); }, threads);
    return;
  }
  const int sweeps = l == 0 ? kSweeps : kSweepsC;
  if (sweeps == 1) {
    for_planes_in_stages<3>(
        layout,
        [&](int stage, int plane) {
          if (stage == 0) first(plane);
          if (stage == 1) relax_plane(plane, 1);
          if (stage == 2) residual(plane);
        },
        threads);
  } else {
    for_planes_in_stages<5>(
        layout,
        [&](int stage, int plane) {
          if (stage == 0) first(plane);
          if (stage == 1 || stage == 3) relax_plane(plane, 1);
          if (stage == 2) relax_plane(plane, 0);
          if (stage == 4) residual(plane);
        },
        threads);
  }
  Level& coarse = levels_[l + 1];
  for_slabs(
      coarse.layout,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          int j = 0;
          for_rows(coarse.layout, k,
                   [&](const Row<D>& row) { restrict_row<Real, D>(level, coarse, k, row, j++); });
        }
      },
      threads);
  cycle(l + 1, threads);
  const auto prolong_plane = [&](int plane) {
    int j = 0;
    for_rows(layout, plane,
             [&](const Row<D>& row) { prolong<Real, D>(level, coarse, plane, row, j++); });
  };
  if (sweeps == 1) {
    for_planes_in_stages<3>(
        layout,
        [&](int stage, int plane) {
          if (stage == 0) prolong_plane(plane);
          if (stage == 1) relax_plane(plane, 1);
          if (stage == 2) relax_plane(plane, 0);
        },
        threads);
  } else {
    for_planes_in_stages<5>(
        layout,
        [&](int stage, int plane) {
          if (stage == 0) prolong_plane(plane);
          if (stage == 1 || stage == 3) relax_plane(plane, 1);
          if (stage == 2 || stage == 4) relax_plane(plane, 0);
        },
        threads);
  }
}

template class Multigrid<float, 2>;
template class Multigrid<float, 3>;
template class Multigrid<double, 2>;
template class Multigrid<double, 3>;

}  // namespace substep::gridfluid
