#include "substep/gridfluid/confinement.h"

#include <algorithm>
#include <cmath>

namespace substep::gridfluid {
namespace {

// Twice the difference over two cells of component a of the velocity, in the middle of cell i,
// along another axis.
template <class Real, int D>
Real slope(const Layout<D>& layout, const Velocity<Real, D>& u, std::size_t a, std::size_t along,
           std::int64_t i) {
  const auto pair = [&](std::int64_t j) {
    return u[a][usize(j)] + u[a][usize(j + layout.stride[a])];
  };
  return pair(i + layout.stride[along]) - pair(i - layout.stride[along]);
}

}  // namespace

template <class Real, int D>
void Confinement<Real, D>::add(const Layout<D>& layout, const SideGhosts<Real, D>& sides,
                               const Velocity<Real, D>& u, double strength,
                               Velocity<Real, D> changes, Velocity<Real, D> omega,
                               std::span<Real> size, int threads) {
  // The curl; in two dimensions its one component, out of the plane.
  for_rows(layout, all_cells(layout), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      Real square = 0;
      for (std::size_t c = 0; c < (D == 2 ? 1 : 3); ++c) {
        const std::size_t a = D == 2 ? 0 : (c + 1) % D, b = D == 2 ? 1 : (c + 2) % D;
        const Real w =
            (slope<Real, D>(layout, u, b, a, i) - slope<Real, D>(layout, u, a, b, i)) / 4;
        omega[c][usize(i)] = w;
        square += w * w;
      }
      size[usize(i)] = std::sqrt(square);
    }
  });
  // Component `of` of N x omega in a cell.
  const auto force = [&](const std::array<int, D>& cell, std::int64_t i, std::size_t of) {
    std::array<Real, D> n;
    Real square = 0;
    for (std::size_t b = 0; b < D; ++b) {
      const std::int64_t s = layout.stride[b];
      const Real above = size[usize(cell[b] + 1 < layout.cells[b] ? i + s : i)];
      const Real below = size[usize(cell[b] > 0 ? i - s : i)];
      n[b] = above - below;
      square += n[b] * n[b];
    }
    if (!(square > 0)) return Real(0);
    const Real over = 1 / std::sqrt(square);
    if constexpr (D == 2) {
      return (of == 0 ? n[1] : -n[0]) * over * omega[0][usize(i)];
    } else {
      const std::size_t b = (of + 1) % 3, c = (of + 2) % 3;
      return (n[b] * omega[c][usize(i)] - n[c] * omega[b][usize(i)]) * over;
    }
  };
  for (std::size_t a = 0; a < D; ++a) {
    const std::int64_t s = layout.stride[a];
    for_placed_rows(layout, sides.inner_faces(a), threads,
                    [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
                      for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) {
                        std::array<int, D> before = cell;
                        --before[a];
                        std::int64_t j = i - s;
                        if (before[a] < 0)
                          before[a] = layout.cells[a] - 1, j += layout.cells[a] * s;
                        changes[a][usize(i)] +=
                            Real(strength) * (force(cell, i, a) + force(before, j, a)) / 2;
                      }
                    });
  }
}

template struct Confinement<float, 2>;
template struct Confinement<float, 3>;
template struct Confinement<double, 2>;
template struct Confinement<double, 3>;

}  // namespace substep::gridfluid
