#include <algorithm>
#include <cstring>
#include <limits>

#include "substep/core/usize.h"
#include "substep/gridfluid/pressure/multigrid.h"

namespace substep::gridfluid {

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

template class Multigrid<float, 2>;
template class Multigrid<float, 3>;
template class Multigrid<double, 2>;
template class Multigrid<double, 3>;

}  // namespace substep::gridfluid
