#include "substep/gridfluid/particles/surface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/particles/slabs.h"

namespace substep::gridfluid {
namespace {

constexpr std::int64_t kRowsOfPass = 32;

// The distance from the surface of a half-space for its density.
template <class Real>
Real distance_of_density(Real rho) {
  rho = rho > 0 ? rho : Real(0);
  rho = rho < 1 ? rho : Real(1);
  return rho < Real(0.5) ? 1 - std::sqrt(2 * rho) : std::sqrt(2 * (1 - rho)) - 1;
}

// The square of the distance from the centre of a cell to the nearest particle in the cells around.
template <class Real, int D>
Real nearest_square(const Particles<Real, D>& particles, const Layout<D>& layout, std::int64_t cell,
                    const std::type_identity_t<std::array<Real, D>>& centre) {
  Real nearest = 4 * D;
  const auto x = positions(particles);
  for (int r = 0; r < (D == 2 ? 3 : 9); ++r) {
    std::array<std::int64_t, 2> across{r % 3 - 1, r / 3 - 1};
    std::int64_t row = cell + across[0] * layout.stride[0];
    if constexpr (D == 3) row += across[1] * layout.stride[1];
    // The cells of a row follow each other. There are no particles in ghosts.
    for (std::int32_t p = particles.first()[row - 1]; p < particles.first()[row + 2]; ++p) {
      Real square = 0;
      for (std::size_t d = 0; d < D; ++d) {
        const Real way = x[d][p] - centre[d];
        square += way * way;
      }
      nearest = std::min(nearest, square);
    }
  }
  return nearest;
}

// Rows with liquid in them or in a row up to so many further on along each axis across.
template <class Real, int D>
std::vector<std::uint8_t> rows_near(const Layout<D>& layout, const Real* density, int rows) {
  std::vector<std::uint8_t> near(usize(layout.rows()));
  for (std::int64_t r = 0; r < layout.rows(); ++r) {
    const Real *const begin = density + layout.row(r), *const end = begin + layout.row_length();
    near[usize(r)] = std::any_of(begin, end, [](Real rho) { return rho > 0; });
  }
  for (std::size_t a = 0; a < D - 1; ++a) {
    const std::vector<std::uint8_t> from = near;
    const std::int64_t n = layout.cells[a], step = a == D - 2 ? 1 : layout.cells[D - 2];
    for (std::int64_t r = 0; r < layout.rows(); ++r) {
      const std::int64_t at = r / step % n;
      for (std::int64_t way = -rows; way <= rows && near[usize(r)] == 0; ++way) {
        std::int64_t to = at + way;
        if (layout.periodic[a]) to = (to % n + n) % n;
        if (to >= 0 && to < n) near[usize(r)] |= from[usize(r + (to - at) * step)];
      }
    }
  }
  return near;
}

// |phi| at a cell whose neighbours along each axis have a[0], a[1], ... at the nearer side.
template <class Real>
Real upwind(Real a, Real b) {
  const Real low = std::min(a, b), high = std::max(a, b), gap = high - low;
  const Real both = (low + high + std::sqrt(std::max(2 - gap * gap, Real(0)))) / 2;
  return gap < 1 ? both : low + 1;
}
template <class Real>
Real upwind(Real a, Real b, Real c) {
  const Real two_low = std::min(a, b), two_high = std::max(a, b);
  const Real high = std::max(two_high, c), rest = std::min(two_high, c);
  const Real two = upwind(two_low, rest);  // of the two lowest
  const Real sum = a + b + c, squares = a * a + b * b + c * c;
  const Real all = (sum + std::sqrt(std::max(sum * sum - 3 * (squares - 1), Real(0)))) / 3;
  return two > high ? all : two;
}

// to = the distance from signs and distances next to a cell; a sign never changes.
template <class Real, int D>
void march_row(const Layout<D>& layout, std::int64_t row, Real far, const Real* from, Real* to) {
  const Real* const __restrict phi = from + row;
  Real* const __restrict result = to + row;
  const std::int64_t s0 = layout.stride[0], s1 = layout.stride[D - 2];
  const auto side = [&](Real here, Real there) {  // its distance, if it is on the same side
    return (here < 0) == (there < 0) ? std::abs(there) : far;
  };
  const int cells = layout.row_length();
  for (int k = 0; k < cells; ++k) {
    const Real here = phi[k], own = std::abs(here);
    const Real a = std::min(side(here, phi[k - 1]), side(here, phi[k + 1]));
    const Real b = std::min(side(here, phi[k - s1]), side(here, phi[k + s1]));
    Real d;
    if constexpr (D == 2) {
      d = upwind(a, b);
    } else {
      d = upwind(a, b, std::min(side(here, phi[k - s0]), side(here, phi[k + s0])));
    }
    d = std::min(d, own);
    result[k] = here < 0 ? -d : d;
  }
}

// cell(index, how many of its neighbours are in the liquid) for the cells of a row.
template <class Real, int D, class Cell>
void for_wet_neighbours(const Layout<D>& layout, const Real* phi, std::int64_t row,
                        const Cell& cell) {
  constexpr int kBlock = 64;
  for (int k0 = 0; k0 < layout.row_length(); k0 += kBlock) {
    const int count = std::min(kBlock, layout.row_length() - k0);
    IntOf<Real> wet[kBlock] = {};
    for (const std::int64_t step : layout.stride) {
      const Real* const here = phi + row + k0;
      for (int k = 0; k < count; ++k) wet[k] += (here[k - step] < 0) + (here[k + step] < 0);
    }
    _Pragma("GCC ivdep") for (int k = 0; k < count; ++k) {
      cell(row + k0 + k, static_cast<int>(wet[k]));
    }
  }
}

}  // namespace

template <class Real, int D>
void level_set(const Particles<Real, D>& particles, const Layout<D>& layout, const Real* density,
               const SurfaceOptions<Real>& options, Real* phi, AlignedBuffer<Real>& scratch,
               int threads) {
  const Real far = static_cast<Real>(options.layers + 1);
  if (scratch.size() != usize(layout.size)) {
    scratch.reset(usize(layout.size));
    std::fill(scratch.begin(), scratch.end(), far);
  }
  Real* const other = scratch.data();
  const int passes = (options.layers + 1) / 2 * 2;  // even: from phi to `other` and back
  const std::int64_t rows_of_plane = layout.rows() / layout.cells[0];
  const std::vector<std::uint8_t> near = rows_near(layout, density, passes + 2);

  // phi of density and balls.
  const auto estimate = [&](std::int64_t r) {
    const std::int64_t row = layout.row(r);
    const int cells = layout.row_length();
    for (int k = 0; k < cells; ++k) phi[row + k] = distance_of_density(density[row + k]);
    std::array<Real, D> centre{static_cast<Real>(r / rows_of_plane) + Real(0.5),
                               static_cast<Real>(r % rows_of_plane) + Real(0.5)};
    for (int k = 0; k < cells; ++k) {
      if (density[row + k] == 0 || phi[row + k] <= 0) continue;
      centre[D - 1] = static_cast<Real>(k) + Real(0.5);
      const Real ball =
          std::sqrt(nearest_square(particles, layout, row + k, centre)) - options.radius;
      phi[row + k] = std::min(phi[row + k], ball);
    }
  };
  const auto close_holes = [&](std::int64_t r) {
    for_wet_neighbours(layout, phi, layout.row(r), [&](std::int64_t i, int wet) {
      const bool particle = particles.first()[i] < particles.first()[i + 1];
      other[i] = (wet == 2 * D) & particle & (phi[i] >= 0) ? Real(-0.5) : phi[i];
    });
  };
  // Only cells next to the other side of the surface keep their distance.
  const auto keep_surface = [&](std::int64_t r) {
    for_wet_neighbours(layout, other, layout.row(r), [&](std::int64_t i, int wet) {
      const bool inside = other[i] < 0, surface = wet != (inside ? 2 * D : 0);
      phi[i] = surface ? other[i] : inside ? -far : far;
    });
  };

  const std::int64_t tasks = (layout.rows() - 1) / kRowsOfPass + 1;
  std::vector<std::int64_t> chunks;  // rows, ghosts, rows, ghosts, ...
  for (int pass = 0; pass < 3 + passes; ++pass) chunks.insert(chunks.end(), {tasks, 1});
  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const std::int64_t pass = phase / 2;
    Real* const to = pass % 2 == 0 ? phi : other;
    if (phase % 2 == 1) return fill_ghosts(layout, kCentres, to);
    const std::int64_t begin = chunk * kRowsOfPass;
    for (std::int64_t r = begin; r < std::min(begin + kRowsOfPass, layout.rows()); ++r) {
      if (near[usize(r)] == 0) {
        const std::int64_t row = layout.row(r);
        if (pass < 2) std::fill(to + row, to + row + layout.row_length(), far);
      } else if (pass == 0) {
        estimate(r);
      } else if (pass == 1) {
        close_holes(r);
      } else if (pass == 2) {
        keep_surface(r);
      } else {
        march_row(layout, layout.row(r), far, to == phi ? other : phi, to);
      }
    }
  };
  parallel_phases(chunks, std::cref(run), threads);
}

template void level_set(const Particles<float, 2>&, const Layout<2>&, const float*,
                        const SurfaceOptions<float>&, float*, AlignedBuffer<float>&, int);
template void level_set(const Particles<float, 3>&, const Layout<3>&, const float*,
                        const SurfaceOptions<float>&, float*, AlignedBuffer<float>&, int);
template void level_set(const Particles<double, 2>&, const Layout<2>&, const double*,
                        const SurfaceOptions<double>&, double*, AlignedBuffer<double>&, int);
template void level_set(const Particles<double, 3>&, const Layout<3>&, const double*,
                        const SurfaceOptions<double>&, double*, AlignedBuffer<double>&, int);

}  // namespace substep::gridfluid
