#include "substep/gridfluid/flow/central.h"

#include <algorithm>

namespace substep::gridfluid {
namespace {

// Takes the part of axis b, of numbers of a row.
template <class Real, int D>
void along(const Layout<D>& layout, const Velocity<Real, D>& flow, const Velocity<Real, D>& u,
           std::size_t a, std::size_t b, std::int64_t begin, std::int64_t end,
           std::span<Real> out) {
  const std::int64_t s = layout.stride[a], t = layout.stride[b], over = a == b ? s : t;
  const Real *x = u[a].data(), *v = flow[b].data();
  Real* __restrict to = out.data();
  for (std::int64_t i = begin; i < end; ++i) {
    // Twice the velocities through the faces of the cell around.
    const Real below = v[i - s] + v[i], above = v[i - s + over] + v[i + over];
    to[i] -= (above * (x[i + t] - x[i]) + below * (x[i] - x[i - t])) / 4;
  }
}

// In an open side, whose cells inside are those of `column`, and inner the next face. What flows in
// comes from rest: else eddies that leave would draw in energy without bound.
template <class Real, int D>
Real in_open_side(const Layout<D>& layout, const Velocity<Real, D>& v, const Velocity<Real, D>& u,
                  std::size_t a, std::int64_t i, std::int64_t inner, std::int64_t column,
                  Real outward) {
  Real sum =
      outward > 0 ? outward * (u[a][usize(i)] - u[a][usize(inner)]) : -outward * u[a][usize(i)];
  for (std::size_t b = 0; b < D; ++b) {
    if (b == a) continue;
    const std::int64_t t = layout.stride[b];
    const Real here = u[a][usize(i)];
    sum += (v[b][usize(column + t)] * (u[a][usize(i + t)] - here) +
            v[b][usize(column)] * (here - u[a][usize(i - t)])) /
           2;
  }
  return sum;
}

// Koren's phi(r) over r's denominator: what is added to the value upwind, of half the differences
// from the one before to it, `behind`, and from it to the next, `ahead`.
template <class Real>
Real koren(Real behind, Real ahead) {
  const Real b = std::abs(behind), a = std::abs(ahead);
  const Real most = std::min(std::min(2 * b, (a * 2 + b) / 3), 2 * a);
  return behind * ahead > 0 ? (ahead > 0 ? most : -most) / 2 : Real(0);
}

}  // namespace

template <class Real, int D>
void Fluxes<Real, D>::central(const Layout<D>& layout, const SideGhosts<Real, D>& sides,
                              const Velocity<Real, D>& v, const Velocity<Real, D>& u, std::size_t a,
                              std::span<Real> out, int threads) {
  for_rows(layout, sides.inner_faces(a), threads, [&](std::int64_t begin, std::int64_t end) {
    std::fill(out.begin() + begin, out.begin() + end, Real(0));
    for (std::size_t b = 0; b < D; ++b) along<Real, D>(layout, v, u, a, b, begin, end, out);
  });
  for (std::size_t end = 0; end < 2; ++end) {
    if (!sides.is(a, end, SideKind::kOpen)) continue;
    Block<D> side = all_faces(layout, a);
    (end == 0 ? side.to[a] : side.from[a]) = end == 0 ? 1 : layout.cells[a];
    const std::int64_t s = layout.stride[a];
    for_rows(layout, side, threads, [&](std::int64_t first, std::int64_t last) {
      for (std::int64_t i = first; i < last; ++i) {
        const Real out_of = end == 0 ? -v[a][usize(i)] : v[a][usize(i)];
        const std::int64_t inner = end == 0 ? i + s : i - s, column = end == 0 ? i : i - s;
        out[usize(i)] = -in_open_side<Real, D>(layout, v, u, a, i, inner, column, out_of);
      }
    });
  }
}

template <class Real, int D>
void Fluxes<Real, D>::limited(const Layout<D>& layout, const Velocity<Real, D>& u,
                              const std::array<std::span<const Real>, D>& open,
                              std::span<const Real> x, std::span<Real> out, int threads) {
  // Adds what comes into cells of a row through their lower or upper faces across axis b, number c
  // of it, of what these carry less what is in the cell.
  const auto add = [&](std::size_t b, bool upper, int c, std::int64_t begin, std::int64_t end) {
    const std::int64_t s = layout.stride[b], n = layout.cells[b];
    const std::int64_t face = upper ? s : 0, round = layout.periodic[b] ? n * s : 0;
    const Real sign = upper ? Real(-1) : Real(1);
    const Real *v = u[b].data() + face, *at = x.data() + face, *here = x.data();
    const Real* part = open[b].empty() ? nullptr : open[b].data() + face;
    Real* __restrict to = out.data();
    if ((c == 0 || c == n) && !layout.periodic[b]) {
      // What flows in is between the ghost and the cell.
      for (std::int64_t i = begin; i < end; ++i) {
        const Real flow = part != nullptr ? v[i] * part[i] : v[i];
        const bool up = v[i] > 0;
        const Real from = up ? at[i - s] : at[i];
        const Real value = up == (c == 0) ? (at[i - s] + at[i]) / 2 : from;
        to[i] += sign * flow * (value - here[i]);
      }
      return;
    }
    const Real* before = at - 2 * s + (c == 0 ? round : 0);
    const Real* after = at + s - (c == n ? round : 0);
    for (std::int64_t i = begin; i < end; ++i) {
      const Real flow = part != nullptr ? v[i] * part[i] : v[i];
      const bool up = v[i] > 0;
      const Real low = at[i - s], high = at[i], step = high - low;
      const Real behind = up ? low - before[i] : high - after[i];
      const Real value = (up ? low : high) + koren(behind, up ? step : -step);
      to[i] += sign * flow * (value - here[i]);
    }
  };
  for_placed_rows(layout, all_cells(layout), threads,
                  [&](const std::array<int, D>& cell, std::int64_t begin, std::int64_t end) {
                    std::fill(out.begin() + begin, out.begin() + end, Real(0));
                    for (std::size_t b = 0; b + 1 < D; ++b) {
                      add(b, false, cell[b], begin, end);
                      add(b, true, cell[b] + 1, begin, end);
                    }
                    const int n = layout.cells[D - 1];
                    add(D - 1, false, 0, begin, begin + 1);
                    add(D - 1, false, 1, begin + 1, end);
                    add(D - 1, true, 1, begin, end - 1);
                    add(D - 1, true, n, end - 1, end);
                  });
}

template struct Fluxes<float, 2>;
template struct Fluxes<float, 3>;
template struct Fluxes<double, 2>;
template struct Fluxes<double, 3>;

}  // namespace substep::gridfluid
