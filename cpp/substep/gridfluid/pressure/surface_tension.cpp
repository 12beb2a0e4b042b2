#include "substep/gridfluid/pressure/surface_tension.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/cells.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

constexpr int kSweeps = 8;
constexpr double kDrawIn = 0.01;  // curvature for a cell of distance [1/cell^2]
// How far outside of the level c = 1/2 the surface is, over its curvature: s^2 (2 - sqrt 2) / (4 -
// sqrt 2), with s^2 = kSweeps / 2.
constexpr double kBeyond = 0.2265 * kSweeps / 2;  // [cells^2]
constexpr std::int64_t kRowsOfSweep = 16;

// One sweep of (1, 2, 1) / 4 along each axis.
template <class Real, int D>
void smooth_row(const Layout<D>& layout, std::int64_t row, const Real* from, Real* to) {
  constexpr int kBlock = 64;
  constexpr Real kScale = Real(1) / (D == 2 ? 16 : 64);
  const int cells = layout.row_length();
  const std::int64_t s0 = layout.stride[0], s1 = layout.stride[D - 2];
  for (int k0 = 0; k0 < cells; k0 += kBlock) {
    const int count = std::min(kBlock, cells - k0);
    Real across[kBlock + 2];
    const Real* const __restrict x = from + row + k0 - 1;
    for (int k = 0; k < count + 2; ++k) {
      const auto three = [&](std::int64_t i) { return x[i - s1] + 2 * x[i] + x[i + s1]; };
      across[k] = three(k);
      if constexpr (D == 3) across[k] = three(k - s0) + 2 * across[k] + three(k + s0);
    }
    Real* const __restrict y = to + row + k0;
    for (int k = 0; k < count; ++k) {
      y[k] = kScale * (across[k] + 2 * across[k + 1] + across[k + 2]);
    }
  }
}

// With n = grad c / |grad c|, H the second derivatives of c and P = I - n n: kappa = -div n and
// grad n = P H P / |grad c|, by central differences. It is at most that of a ball of two cells, or
// specks, which c hardly shows, would be pulled apart by differences over them.
template <class Real, int D>
Real curvature_of(const Layout<D>& layout, const Real* c) {
  constexpr Real kFlat = Real(1e-5);  // where |grad c|^2 is less, c has no direction
  constexpr Real kFar = 8;            // that the surface may be away [cells]
  constexpr Real kMost = Real(D - 1) / 2;
  std::array<Real, D> g, Hg{};
  std::array<std::array<Real, D>, D> H;
  Real square = kFlat;
  for (std::size_t a = 0; a < D; ++a) {
    const std::int64_t s = layout.stride[a];
    g[a] = (c[s] - c[-s]) / 2;
    square += g[a] * g[a];
    H[a][a] = c[s] - 2 * c[0] + c[-s];
    for (std::size_t b = 0; b < a; ++b) {
      const std::int64_t t = layout.stride[b];
      H[a][b] = H[b][a] = ((c[s + t] - c[s - t]) - (c[t - s] - c[-s - t])) / 4;
    }
  }
  Real trace = 0, squares = 0, along = 0, along_squares = 0;  // of H, H H, n H n, n H H n
  for (std::size_t a = 0; a < D; ++a) {
    trace += H[a][a];
    for (std::size_t b = 0; b < D; ++b) {
      squares += H[a][b] * H[a][b];
      Hg[a] += H[a][b] * g[b];
    }
    along += g[a] * Hg[a] / square;
    along_squares += Hg[a] * Hg[a] / square;
  }
  const Real length = std::sqrt(square);
  const Real kappa = (along - trace) / length;
  const Real change = (squares - 2 * along_squares + along * along) / square;  // |grad n|^2
  const Real outside = std::clamp((Real(0.5) - c[0]) / length, -kFar, kFar);
  const Real here =
      kappa + (outside - Real(kBeyond) * kappa) * (change + static_cast<Real>(kDrawIn));
  const Real shown = std::clamp(50 * std::min(c[0], 1 - c[0]) - Real(0.5), Real(0), Real(1));
  return shown * std::clamp(here, -kMost, kMost);
}

// to = from after kSweeps.
template <class Real, int D>
void smooth(const Layout<D>& layout, const Real* from, Real* to, Real* scratch, int threads) {
  static_assert(kSweeps % 2 == 0);
  const std::int64_t tasks = (layout.rows() - 1) / kRowsOfSweep + 1;
  std::vector<std::int64_t> chunks;  // rows, ghosts, rows, ghosts, ...
  for (int sweep = 0; sweep < kSweeps; ++sweep) chunks.insert(chunks.end(), {tasks, 1});
  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const bool back = phase / 2 % 2 == 1;
    Real* const y = back ? to : scratch;
    if (phase % 2 == 1) return fill_ghosts(layout, kCentres, y);
    const Real* const x = back ? scratch : phase == 0 ? from : to;
    const std::int64_t begin = chunk * kRowsOfSweep;
    for (std::int64_t r = begin; r < std::min(begin + kRowsOfSweep, layout.rows()); ++r) {
      smooth_row(layout, layout.row(r), x, y);
    }
  };
  parallel_phases(chunks, std::cref(run), threads);
}

}  // namespace

template <class Real, int D>
void SurfaceTension<Real, D>::find_curvature(const Layout<D>& layout, const Real* phi,
                                             int threads) {
  if (kappa_.size() != usize(layout.size)) {
    for (auto* field : {&kappa_, &once_, &twice_}) assign(*field, layout.size, Real(0));
  }
  Real *const once = once_.data(), *const twice = twice_.data(), *const kappa = kappa_.data();
  for_numbers(layout.size, threads,
              [&](std::size_t i) { once[i] = std::clamp(Real(0.5) - phi[i], Real(0), Real(1)); });
  smooth(layout, once, once, kappa, threads);
  smooth(layout, once, twice, kappa, threads);
  for_numbers(layout.size, threads, [&](std::size_t i) { once[i] = 2 * once[i] - twice[i]; });
  for_rows(layout, all_cells(layout), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      bool beside = false;
      for (const std::int64_t s : layout.stride) {
        beside |= (phi[i] < 0) != (phi[i - s] < 0) || (phi[i] < 0) != (phi[i + s] < 0);
      }
      kappa[i] = beside ? curvature_of(layout, once + i) : Real(0);
    }
  });
  fill_ghosts(layout, kCentres, kappa);
}

// Over the part theta of the way to the middle of the liquid cell: u -= s_f q_f / theta_f, as in
// projection.h.
template <class Real, int D>
void SurfaceTension<Real, D>::pull(const Layout<D>& layout, const Obstacles<Real, D>& obstacles,
                                   const Projection<Real, D>& projection, const Real* phi,
                                   double q_of_curvature, const Velocity<Real, D>& u, int threads) {
  find_curvature(layout, phi, threads);
  const std::span<const Cell> cells = projection.cells();
  const auto factor = static_cast<Real>(q_of_curvature);
  for (int axis = 0; axis < D; ++axis) {
    const std::int64_t s = layout.stride[usize(axis)];
    const std::span<const Real> weight = projection.weight(axis);
    const std::span<const Real> part =
        obstacles.any() ? obstacles.open(axis) : std::span<const Real>();
    for_rows(
        layout, all_faces(layout, usize(axis)), threads, [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t i = begin; i < end; ++i) {
            const bool below = cells[usize(i - s)] == Cell::kFluid,
                       above = cells[usize(i)] == Cell::kFluid;
            if (below == above || !(weight[usize(i)] > 0)) continue;
            const Real kappa = (phi[i] * kappa_[usize(i - s)] - phi[i - s] * kappa_[usize(i)]) /
                               (phi[i] - phi[i - s]);
            const Real over_theta = weight[usize(i)] / (part.empty() ? Real(1) : part[usize(i)]);
            u[usize(axis)][usize(i)] += (above ? factor : -factor) * kappa * over_theta;
          }
        });
  }
}

template class SurfaceTension<float, 2>;
template class SurfaceTension<float, 3>;
template class SurfaceTension<double, 2>;
template class SurfaceTension<double, 3>;

}  // namespace substep::gridfluid
