#include "substep/gridfluid/pressure/multigrid.h"

#include <cstring>
#include <limits>

#include "substep/core/errors.h"

namespace substep::gridfluid {
namespace {

constexpr double kDamping = 0.8;
constexpr std::int64_t kSerial = 1 << 13;  // cells of a level that is not worth sharing

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

template <class Real, int D>
void Multigrid<Real, D>::set_matrix(const Coefficients& w, std::span<const Cell> cells,
                                    int threads) {
  Level& finest = levels_[0];
  for (std::size_t a = 0; a < D; ++a) finest.w[a] = w[a].data();
  const auto* const kinds = reinterpret_cast<const unsigned char*>(cells.data());
  finest.fluid.set(
      [&](std::int64_t r) -> typename FluidRows<D>::Part {
        constexpr int kFluid = static_cast<int>(Cell::kFluid);
        const unsigned char* const row = kinds + finest.layout.row(r);
        const auto n = usize(finest.layout.row_length());
        const auto* const first = static_cast<const unsigned char*>(std::memchr(row, kFluid, n));
        if (!first) return {0, 0};
        const auto* const last = static_cast<const unsigned char*>(::memrchr(row, kFluid, n));
        return {static_cast<int>(first - row), static_cast<int>(last - row) + 1};
      },
      threads);
  finest.fluid.clear(finest.inverse_diagonal.data(), threads);
  for_slabs(
      finest.fluid,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k)
          for_rows(finest.fluid, k, [&](const Row<D>& row) {
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
  for (std::size_t l = 1; l < levels_.size(); ++l) {
    find_fluid(levels_[l - 1], levels_[l], threads);
    coarsen(levels_[l - 1], levels_[l], threads);
  }
}

// Where aggregates have fluid.
template <class Real, int D>
void Multigrid<Real, D>::find_fluid(const Level& fine, Level& coarse, int threads) {
  const std::int64_t of_plane = coarse.fluid.rows_of_plane(),
                     fine_of_plane = fine.fluid.rows_of_plane();
  coarse.fluid.set(
      [&](std::int64_t r) {
        typename FluidRows<D>::Part whole{std::numeric_limits<int>::max(), 0};
        for (int child = 0; child < 4; ++child) {
          const std::int64_t k = 2 * (r / of_plane) + child / 2, j = 2 * (r % of_plane) + child % 2;
          if (k >= fine.layout.cells[0] || j >= fine_of_plane) continue;
          const auto part = fine.fluid.part(k * fine_of_plane + j);
          if (part.begin == part.end) continue;
          whole.begin = std::min(whole.begin, part.begin / 2);
          whole.end = std::max(whole.end, (part.end + 1) / 2);
        }
        return whole;
      },
      threads);
  const auto clear = [&](AlignedBuffer<Real>& x) { coarse.fluid.clear(x.data(), threads); };
  clear(coarse.inverse_diagonal), clear(coarse.own_b), clear(coarse.own_x), clear(coarse.own_r);
  for (std::size_t a = 0; a < D; ++a) {
    clear(coarse.own_w[a]);
    for (std::size_t side : {0, 1})
      clear(coarse.lean[a][side]), clear(coarse.loss[a][side]), clear(coarse.own_air[a][side]);
  }
}

// Coarse cells are 2^D cells each, or what there is of them, and their unknown is at their centre.
// Along each column of cells a flow passes resistances one after the other, and columns lie side by
// side: from the centre, half the resistance 1 / w of the face in the middle (none where the column
// has one cell only, which then stands for the centre), that of the face between, and half of that
// in the middle beyond. So coarse cells are coupled by sums over columns of
//   k = 1 / (1 / (2 w_inner) + 1 / w + 1 / (2 w_far)),
// which is what one finds on a grid twice as coarse, for any surface and open areas; and those to
// air likewise, so that the surface stays where it is. A column's share of a difference of pressure
// between centres that falls off within the own cell is k / (2 w_inner), which is the weight by
// which its cells' pressure leans on the neighbour. It is 1/4 in a column of equal w: then P is
// linear (Khalil and Wesseling, "Vertex-centered and cell-centered multigrid for interface
// problems", 1992), and R = P^T. Halves are at most one whole 1 / w: next to a narrow gap a cell is
// reached from the side.
namespace {

// Along an axis of n cells, on one side of an aggregate: the cell beside the face, the other one,
// the cell across, the one behind it, and the face. Ghosts, where there is no unknown, if there are
// no such cells.
inline std::array<int, 5> column_of(int coarse, int side, int n, bool periodic) {
  const int lower = 2 * coarse, upper = lower + 1;  // upper may be a ghost
  const bool upward = side == 1 && upper < n;
  const int beside = upward ? upper : lower, other = upward ? lower : upper;
  int across = side == 1 ? beside + 1 : lower - 1;
  if (periodic) across = (across + n) % n;
  const bool ghost = across < 0 || across >= n;
  const int behind = ghost ? across : across ^ 1;
  return {beside, other, across, behind, side == 1 ? across : beside};
}

}  // namespace

template <class Real, int D>
void Multigrid<Real, D>::add_columns(const Level& fine, Level& coarse, std::size_t a, int side,
                                     const std::array<std::int64_t, 5>& column, std::int64_t at,
                                     int n) {
  const auto s = usize(side);
  const auto [beside, other, across, behind, face] = column;
  const Real* const known = fine.inverse_diagonal.data();
  const Real *const b = known + beside, *const o = known + other, *const x = known + across,
                    *const h = known + behind;
  const Real *const w = fine.w[a] + face, *const inner = fine.w[a] + std::max(beside, other),
                    *const beyond = fine.w[a] + std::max(across, behind);
  const bool finest = fine.own_air[a][s].size() == 0;
  const Real *const own_air = finest ? nullptr : fine.own_air[a][s].data() + beside,
                    *const other_air = finest ? nullptr : fine.own_air[a][s].data() + other;
  Real *const link = coarse.own_x.data() + at, *const count = coarse.own_b.data() + at,
              *const air = coarse.own_air[a][s].data() + at,
              *const lean = coarse.lean[a][s].data() + at,
              *const loss = coarse.loss[a][s].data() + at;
  // w_air: of the cell beside, and of the other.
  const auto add = [&](int i, Real w_air, Real w_other) {
    const int j = 2 * i;
    const bool here = b[j] > 0;
    w_air = here ? w_air : 0;
    const Real w_face = here && x[j] > 0 ? w[j] : 0;
    const Real w_inner = here && o[j] > 0 ? inner[j] : 0, w_far = h[j] > 0 ? beyond[j] : 0;
    const auto half = [](Real of, Real by) {
      return by > 0 ? std::min(Real(.5) * of / by, Real(1)) : Real(0);
    };
    const Real own = half(w_face, w_inner), k = 1 / (1 + own + half(w_face, w_far));
    const Real own_of_air = half(w_air, w_inner), k_air = 1 / (1 + own_of_air);
    link[i] += w_face * k;
    air[i] += w_air * k_air + (o[j] > 0 ? w_other : 0);
    lean[i] += own * k;
    loss[i] += own * k + own_of_air * k_air;
    count[i] += here;
  };
  if (finest) {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i)
      add(i, x[2 * i] > 0 ? 0 : w[2 * i], b[2 * i] > 0 ? 0 : inner[2 * i]);
  } else {
#pragma GCC ivdep
    for (int i = 0; i < n; ++i) add(i, own_air[2 * i], other_air[2 * i]);
  }
}

template <class Real, int D>
void Multigrid<Real, D>::coarsen_row(const Level& fine, Level& coarse, int k, int j,
                                     const Row<D>& row) {
  const Layout<D>&of = fine.layout, &to = coarse.layout;
  const int n = row.length;
  if (n == 0) return;
  Real* const diagonal = coarse.inverse_diagonal.data() + row.at;
  Real *const link = coarse.own_x.data() + row.at, *const count = coarse.own_b.data() + row.at;
  std::fill_n(diagonal, n, Real(0));
  const std::array<int, 3> cell{k, j, 0};
  for (std::size_t a = 0; a < D; ++a) {
    for (int side = 0; side < 2; ++side) {
      Real *const air = coarse.own_air[a][usize(side)].data() + row.at,
                  *const lean = coarse.lean[a][usize(side)].data() + row.at,
                  *const loss = coarse.loss[a][usize(side)].data() + row.at;
      for (Real* sum : {link, count, air, lean, loss}) std::fill_n(sum, n, Real(0));
      for (int c = 0; c < 1 << (D - 1); ++c) {
        // The first cell of a row of columns; `bit` is for the axes but a.
        std::int64_t first = of.first;
        for (std::size_t e = 0, bit = 0; e < D; ++e) {
          if (e == a) continue;
          first += (2 * (e == D - 1 ? row.begin : cell[e]) + ((c >> bit++) & 1)) * of.stride[e];
        }
        const auto columns = [&](int coarse_index, int from, int length) {
          const std::array<int, 5> along =
              column_of(coarse_index, side, of.cells[a], of.periodic[a]);
          std::array<std::int64_t, 5> column;
          for (std::size_t e = 0; e < 5; ++e) column[e] = first + along[e] * of.stride[a];
          add_columns(fine, coarse, a, side, column, row.at + from, length);
        };
        if (a < D - 1) {
          columns(cell[a], 0, n);
          continue;
        }
        // The first and the last cell of the grid may have ghosts for neighbours.
        const int end = row.begin + n, last = to.row_length() - 1;
        const int from = std::max(row.begin, 1), until = std::min(end, last);
        if (row.begin == 0) columns(0, 0, 1);
        if (from < until) columns(from, from - row.begin, until - from);
        if (end > last && last > 0) columns(last, last - row.begin, 1);
      }
      const bool loops = to.periodic[a] && to.cells[a] == 1;  // it is its own neighbour
      for (int i = 0; i < n; ++i) {
        if (loops) link[i] = lean[i] = loss[i] = 0;
        diagonal[i] += link[i] + air[i];
        const Real scale = count[i] > 0 ? 1 / count[i] : 0;
        lean[i] *= scale, loss[i] *= scale;
      }
      if (side == 0) std::copy_n(link, n, coarse.own_w[a].data() + row.at);
    }
  }
  wrap_row(to, row, coarse.own_w[D - 1].data());
  for (int i = 0; i < n; ++i) diagonal[i] = diagonal[i] > 0 ? 1 / diagonal[i] : 0;
}

template <class Real, int D>
void Multigrid<Real, D>::coarsen(const Level& fine, Level& coarse, int threads) {
  for_slabs(
      coarse.fluid,
      [&](std::int64_t, int begin, int end) {
        for (int k = begin; k < end; ++k) {
          int j = 0;
          for_rows(coarse.fluid, k,
                   [&](const Row<D>& row) { coarsen_row(fine, coarse, k, j++, row); });
        }
      },
      coarse.layout.count() < kSerial ? 1 : threads);
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
