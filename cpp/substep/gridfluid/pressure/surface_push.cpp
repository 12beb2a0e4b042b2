#include "substep/gridfluid/pressure/surface_push.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <variant>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/revolution.h"

namespace substep::gridfluid {
namespace {

using geometry::Collider;
using geometry::Exchange;

// What q carries from the middle of a cell to the surface in it.
template <class Real, int D>
Vec3 carried(const Obstacles<Real, D>& obstacles, const typename Obstacles<Real, D>::Cut& cut,
             const Projection<Real, D>& projection, std::span<const double> q, const Vec3& rest) {
  Vec3 sum = Vec3::Zero();
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    const auto s = usize(obstacles.layout().stride[a]), below = usize(cut.cell), above = below + s;
    const std::span<const Real> open = obstacles.open(axis), w = projection.weight(axis);
    const auto slope = [&](std::size_t face, std::size_t other) {
      const std::size_t f = w[face] > 0 ? face : other;
      return w[f] > 0 ? (q[f] - q[f - s]) * double(w[f] / open[f]) : rest[axis];
    };
    const auto [lower, upper] = cut.beside[a];
    sum[axis] = double(lower) * slope(below, above) + double(upper) * slope(above, below);
  }
  return sum;
}

// What the surface of a collider sums up to in its cells.
struct Sums {
  Exchange push;
  Vec3 area = Vec3::Zero();    // [faces]
  Vec3 volume = Vec3::Zero();  // [cells], by the push of a pressure of slope 1 along each axis
  bool wet = true;             // no cell is air

  Sums& operator+=(const Sums& other) {
    push += other.push;
    area += other.area;
    volume += other.volume;
    wet = wet && other.wet;
    return *this;
  }
};

// With impulse(cut, collider) in the fluid cells in which the surface is, for each of the colliders
// that respond, or for each of the others.
template <class Real, int D, class Impulse>
std::vector<Sums> sum_over_surface(Obstacles<Real, D>& obstacles, std::span<const Cell> cells,
                                   bool respond, const Impulse& impulse, int threads) {
  constexpr std::int64_t kCuts = 256;  // a task
  const std::vector<Collider>& colliders = obstacles.colliders;
  const auto cuts = obstacles.cuts(threads);
  const auto count = static_cast<std::int64_t>(cuts.size());
  std::vector<std::vector<Sums>> parts(usize((count + kCuts - 1) / kCuts));
  parallel_for(
      count, kCuts,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Sums>& part = parts[usize(begin / kCuts)];
        part.resize(colliders.size());
        for (std::int64_t k = begin; k < end; ++k) {
          const auto& cut = cuts[usize(k)];
          const std::size_t c = cut.collider;
          const Cell cell = cells[usize(cut.cell)];
          if (cell == Cell::kSolid || responds(colliders[c]) != respond) continue;
          Sums& sums = part[c];
          sums.wet = sums.wet && cell == Cell::kFluid;
          if (cell != Cell::kFluid) continue;
          const Vec3 arm = obstacles.middle(cut.cell) - colliders[c].position();
          sums.push.add(arm, impulse(cut, c));
          const auto area = obstacles.surface(cut.cell);
          for (std::size_t a = 0; a < D; ++a) {
            const int axis = static_cast<int>(a);
            sums.area[axis] += double(area[a]);
            sums.volume[axis] -= arm[axis] / obstacles.dx * double(area[a]) +
                                 double(cut.beside[a][0] + cut.beside[a][1]);
          }
        }
      },
      threads);
  std::vector<Sums> sums(colliders.size());
  for (const std::vector<Sums>& part : parts)
    for (std::size_t c = 0; c < sums.size(); ++c) sums[c] += part[c];
  for (std::size_t c = 0; c < sums.size(); ++c)
    sums[c].push.torque = turns_of_pressure<D>(colliders[c]) * sums[c].push.torque;
  return sums;
}

// [m^3], in two dimensions [m^2]; below 0 where it is not known.
template <int D>
double volume_of(const Collider& collider) {
  constexpr double pi = std::numbers::pi;
  if (collider.hollow()) return -1;
  const geometry::Shape& shape = collider.shape();
  if (const auto* ball = std::get_if<geometry::Sphere>(&shape)) {
    const double r = ball->radius, z = collider.position().z();
    return D == 2 ? pi * (r * r - z * z) : pi * 4 / 3 * r * r * r;
  }
  if (D == 2) return -1;
  if (const auto* box = std::get_if<geometry::Box>(&shape)) return 8 * box->half_lengths.prod();
  if (const auto* capsule = std::get_if<geometry::Capsule>(&shape)) {
    const double r = capsule->radius;
    return pi * r * r * (r * 4 / 3 + 2 * capsule->half_length);
  }
  if (const auto* cylinder = std::get_if<geometry::Cylinder>(&shape))
    return pi * cylinder->radius * cylinder->radius * 2 * cylinder->half_length;
  return -1;
}

// What the grid sees of a body that is all in the liquid differs from its volume with its place in
// the cells. The push that liquid at rest lacks for that, of this slope: all of the surface has to
// be its own, which then is closed, and the grid to see most of it, or nothing would hold a light
// one.
template <class Real, int D>
Vec3 missing(const Obstacles<Real, D>& obstacles, const Collider& collider, const Sums& sums,
             const Vec3& slope) {
  constexpr double kOpen = 1e-3, kMost = 0.25;  // faces; of its volume
  const double volume = volume_of<D>(collider) / std::pow(obstacles.dx, D);
  Vec3 lack = Vec3::Zero();
  for (int a = 0; a < D; ++a) lack[a] = volume - sums.volume[a];
  const bool closed = sums.area.cwiseAbs().maxCoeff() < kOpen;
  if (!sums.wet || !closed || !(lack.cwiseAbs().maxCoeff() < kMost * volume)) return Vec3::Zero();
  return -lack.cwiseProduct(slope);
}

// For each collider the block of cells, empty where there are none, of its surface and what
// is around it.
template <class Real, int D>
std::vector<Block<D>> blocks_around(Obstacles<Real, D>& obstacles, int threads) {
  constexpr int kAround = 3;  // cells
  const Layout<D>& layout = obstacles.layout();
  std::vector<Block<D>> blocks(obstacles.colliders.size(), {layout.cells, {}});
  for (const auto& cut : obstacles.cuts(threads)) {
    if (cut.beside == decltype(cut.beside){}) continue;
    const std::array<int, D> cell = layout.cell(cut.cell);
    Block<D>& block = blocks[cut.collider];
    for (std::size_t a = 0; a < D; ++a) {
      block.from[a] = std::min(block.from[a], std::max(cell[a] - kAround, 0));
      block.to[a] = std::max(block.to[a], std::min(cell[a] + 1 + kAround, layout.cells[a]));
    }
  }
  return blocks;
}

// The mean slope of q in a block, over the open faces between cells where there is one.
template <class Real, int D>
Vec3 mean_slope(const Obstacles<Real, D>& obstacles, std::span<const double> q,
                const Block<D>& block) {
  const Layout<D>& layout = obstacles.layout();
  Vec3 slope = Vec3::Zero();
  for (std::size_t a = 0; a < D; ++a) {
    const auto s = usize(layout.stride[a]);
    const std::span<const Real> open = obstacles.open(static_cast<int>(a));
    Block<D> faces = block;  // with cells of the block on both sides
    ++faces.from[a];
    double sum = 0, area = 0;
    for (std::int64_t r = 0; r < faces.rows(); ++r) {
      const auto begin = usize(layout.index(faces.row(r)));
      for (std::size_t f = begin; f < begin + usize(faces.length()); ++f) {
        if (q[f] == 0 || q[f - s] == 0) continue;
        sum += double(open[f]) * (q[f] - q[f - s]);
        area += double(open[f]);
      }
    }
    if (area > 0) slope[static_cast<int>(a)] = sum / area;
  }
  return slope;
}

}  // namespace

template <class Real, int D>
void push_surface(Obstacles<Real, D>& obstacles, const Projection<Real, D>& projection,
                  std::span<const double> q, const Vec3& rest, double mass, int threads) {
  if (std::all_of(obstacles.colliders.begin(), obstacles.colliders.end(), responds)) return;
  const auto impulse = [&](const typename Obstacles<Real, D>::Cut& cut, std::size_t) {
    Vec3 sum = carried(obstacles, cut, projection, q, rest);
    const auto area = obstacles.surface(cut.cell);
    for (std::size_t a = 0; a < D; ++a)
      sum[static_cast<int>(a)] += q[usize(cut.cell)] * double(area[a]);
    return Vec3(mass * sum);
  };
  const auto sums = sum_over_surface(obstacles, projection.cells(), false, impulse, threads);
  for (std::size_t c = 0; c < sums.size(); ++c)
    if (!responds(obstacles.colliders[c])) obstacles.colliders[c].set_exchange(sums[c].push);
}

template <class Real, int D>
void push_before(Obstacles<Real, D>& obstacles, std::span<const Cell> cells,
                 std::span<const double> q, double mass, int threads) {
  const std::vector<Block<D>> blocks = blocks_around(obstacles, threads);
  std::vector<Vec3> slopes(blocks.size(), Vec3::Zero());
  for_numbers(
      static_cast<std::int64_t>(blocks.size()), threads,
      [&](std::size_t c) {
        if (responds(obstacles.colliders[c])) slopes[c] = mean_slope(obstacles, q, blocks[c]);
      },
      1);
  const auto impulse = [&](const typename Obstacles<Real, D>::Cut& cut, std::size_t c) {
    Vec3 sum = Vec3::Zero();
    for (std::size_t a = 0; a < D; ++a) {
      const int axis = static_cast<int>(a);
      sum[axis] = mass * double(cut.beside[a][0] + cut.beside[a][1]) * slopes[c][axis];
    }
    return sum;
  };
  const auto sums = sum_over_surface(obstacles, cells, true, impulse, threads);
  for (std::size_t c = 0; c < sums.size(); ++c) {
    Collider& collider = obstacles.colliders[c];
    if (!responds(collider)) continue;
    const bool facet = collider.body.surface >= 0;
    Exchange push = sums[c].push;
    push.impulse += mass * missing(obstacles, collider, sums[c], slopes[c]);
    collider.set_exchange(facet ? Exchange() : push);
    collider.set_exchange(exchange_of<D>(collider.body_impulse()(kMotionPlaces<D>), collider));
  }
}

#define SUBSTEP_PUSH(Real, D)                                                                    \
  template void push_surface(Obstacles<Real, D>&, const Projection<Real, D>&,                    \
                             std::span<const double>, const Vec3&, double, int);                 \
  template void push_before(Obstacles<Real, D>&, std::span<const Cell>, std::span<const double>, \
                            double, int)
SUBSTEP_PUSH(float, 2);
SUBSTEP_PUSH(float, 3);
SUBSTEP_PUSH(double, 2);
SUBSTEP_PUSH(double, 3);
#undef SUBSTEP_PUSH

}  // namespace substep::gridfluid
