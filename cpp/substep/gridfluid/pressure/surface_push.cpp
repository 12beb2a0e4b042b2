#include "substep/gridfluid/pressure/surface_push.h"

#include <algorithm>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::gridfluid {
namespace {

// What q carries from the middle of a cell to the surface in it.
template <class Real, int D>
Vec3 carried(const Obstacles<Real, D>& obstacles, const typename Obstacles<Real, D>::Cut& cut,
             const Projection<Real, D>& projection, std::span<const double> q) {
  Vec3 sum = Vec3::Zero();
  for (std::size_t a = 0; a < D; ++a) {
    const int axis = static_cast<int>(a);
    const std::span<const Real> open = obstacles.open(axis), w = projection.weight(axis);
    const auto s = usize(obstacles.layout().stride[a]), face = usize(cut.cell);
    const bool below = w[face] > 0, above = w[face + s] > 0;
    const auto slope = [&](std::size_t f) { return (q[f] - q[f - s]) * double(w[f] / open[f]); };
    if (below) sum[axis] += double(cut.beside[a][0] + (above ? 0 : cut.beside[a][1])) * slope(face);
    if (above)
      sum[axis] += double(cut.beside[a][1] + (below ? 0 : cut.beside[a][0])) * slope(face + s);
  }
  return sum;
}

}  // namespace

template <class Real, int D>
void push_surface(Obstacles<Real, D>& obstacles, const Projection<Real, D>& projection,
                  std::span<const double> q, double mass, int threads) {
  using geometry::Collider, geometry::Exchange;
  constexpr std::int64_t kCuts = 256;  // a task
  std::vector<Collider>& colliders = obstacles.colliders;
  const auto yields = [](const Collider& c) { return c.yields(); };
  if (std::all_of(colliders.begin(), colliders.end(), yields)) return;
  const auto cuts = obstacles.cuts(threads);
  const auto count = static_cast<std::int64_t>(cuts.size());
  std::vector<std::vector<Exchange>> parts(usize((count + kCuts - 1) / kCuts));
  parallel_for(
      count, kCuts,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Exchange>& part = parts[usize(begin / kCuts)];
        part.resize(colliders.size());
        for (std::int64_t k = begin; k < end; ++k) {
          const auto& cut = cuts[usize(k)];
          if (projection.cells()[usize(cut.cell)] != Cell::kFluid) continue;
          const Vec3 at = obstacles.middle(cut.cell);
          const std::size_t c = obstacles.nearest(at);
          if (colliders[c].yields()) continue;  // see Bodies
          Vec3 impulse = carried(obstacles, cut, projection, q);
          const auto area = obstacles.surface(cut.cell);
          for (std::size_t a = 0; a < D; ++a)
            impulse[static_cast<int>(a)] += q[usize(cut.cell)] * double(area[a]);
          const geometry::SignedDistance d = colliders[c].signed_distance(at);
          part[c].add(at - d.value * d.gradient - colliders[c].position(), mass * impulse);
        }
      },
      threads);
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Exchange sum;
    for (const std::vector<Exchange>& part : parts) sum += part[c];
    if (!yields(colliders[c])) colliders[c].set_exchange(sum);
  }
}

template void push_surface(Obstacles<float, 2>&, const Projection<float, 2>&,
                           std::span<const double>, double, int);
template void push_surface(Obstacles<float, 3>&, const Projection<float, 3>&,
                           std::span<const double>, double, int);
template void push_surface(Obstacles<double, 2>&, const Projection<double, 2>&,
                           std::span<const double>, double, int);
template void push_surface(Obstacles<double, 3>&, const Projection<double, 3>&,
                           std::span<const double>, double, int);

}  // namespace substep::gridfluid
