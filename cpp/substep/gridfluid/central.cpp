#include "substep/gridfluid/central.h"

#include <algorithm>

namespace substep::gridfluid {
namespace {

// The part of axis b != a, or of a itself.
template <class Real, int D>
Real along(const Layout<D>& layout, const Velocity<Real, D>& flow, const Velocity<Real, D>& u,
           std::size_t a, std::size_t b, std::int64_t i) {
  const std::int64_t s = layout.stride[a], t = layout.stride[b];
  const std::span<Real> v = flow[b];
  const Real here = u[a][usize(i)];
  // Twice the velocities through the faces of the cell around.
  const Real below = v[usize(i - s)] + v[usize(i)];
  const Real above = a == b ? v[usize(i)] + v[usize(i + s)] : v[usize(i - s + t)] + v[usize(i + t)];
  return (above * (u[a][usize(i + t)] - here) + below * (here - u[a][usize(i - t)])) / 4;
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
  if (behind * ahead <= 0) return 0;
  const Real most = std::min(
      {2 * std::abs(behind), (std::abs(ahead) * 2 + std::abs(behind)) / 3, 2 * std::abs(ahead)});
  return (ahead > 0 ? most : -most) / 2;
}

}  // namespace

template <class Real, int D>
void Fluxes<Real, D>::central(const Layout<D>& layout, const SideGhosts<Real, D>& sides,
                              const Velocity<Real, D>& v, const Velocity<Real, D>& u, std::size_t a,
                              std::span<Real> out, int threads) {
  for_rows(layout, sides.inner_faces(a), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      Real sum = 0;
      for (std::size_t b = 0; b < D; ++b) sum += along<Real, D>(layout, v, u, a, b, i);
      out[usize(i)] = -sum;
    }
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
  // The velocity through the face below cell i, number c of its axis, and what it carries less what
  // is in cell `of`.
  const auto flux = [&](std::size_t b, std::int64_t i, int c, std::int64_t of) {
    const std::int64_t s = layout.stride[b];
    Real v = u[b][usize(i)];
    if (!open[b].empty()) v *= open[b][usize(i)];
    const int n = layout.cells[b];
    const bool up = v > 0;
    std::int64_t from = up ? i - s : i, to = up ? i : i - s, before = up ? from - s : from + s;
    if (c == 0 || c == n) {
      if (!layout.periodic[b]) {  // what flows in is between the ghost and the cell
        const bool in = up == (c == 0);
        const Real value = in ? (x[usize(from)] + x[usize(to)]) / 2 : x[usize(from)];
        return v * (value - x[usize(of)]);
      }
      if (up && c == 0) before += n * s;
      if (!up && c == n) before -= n * s;
    }
    const Real value =
        x[usize(from)] + koren(x[usize(from)] - x[usize(before)], x[usize(to)] - x[usize(from)]);
    return v * (value - x[usize(of)]);
  };
  for_placed_rows(layout, all_cells(layout), threads,
                  [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
                    for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) {
                      Real sum = 0;
                      for (std::size_t b = 0; b < D; ++b) {
                        sum +=
                            flux(b, i + layout.stride[b], cell[b] + 1, i) - flux(b, i, cell[b], i);
                      }
                      out[usize(i)] = -sum;
                    }
                  });
}

template struct Fluxes<float, 2>;
template struct Fluxes<float, 3>;
template struct Fluxes<double, 2>;
template struct Fluxes<double, 3>;

}  // namespace substep::gridfluid
