#include "substep/gridfluid/flow/stress.h"

#include <algorithm>
#include <limits>
#include <vector>

#include "substep/gridfluid/flow/between.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

constexpr double kNear = 1, kFar = 2;  // cells from the surface, where the flow is looked at

using geometry::Collider;
using geometry::Exchange;

// Of numbers between cells, but not beyond the sides.
template <int D>
double pressure_at(const Layout<D>& layout, std::span<const double> q, std::array<double, D> x) {
  for (std::size_t a = 0; a < D; ++a) x[a] = std::clamp(x[a], 0.5, layout.cells[a] - 0.5);
  Between<double, D> at = between<double, D>(layout, x, -1);
  for (std::size_t a = 0; a < D; ++a) {  // exactly in the last cell
    const int cell = layout.cell(at.base)[a];
    if (cell == layout.cells[a] - 1 && cell > 0) at.base -= layout.stride[a], at.part[a] = 1;
  }
  return interpolate(layout, q, at);
}

}  // namespace

template <class Real, int D>
void Stress<Real, D>::push(const Layout<D>& layout, Obstacles<Real, D>& obstacles,
                           std::span<const Cell> cells, const Extension<D>& into_cells,
                           const Velocity<Real, D>& u, std::span<double> q,
                           std::span<const Real> density, double mass, double shear, int threads) {
  into_cells.apply(layout, q);
  const std::vector<Collider>& colliders = obstacles.colliders;
  const double dx = obstacles.dx;
  // Impulses in the cell, on the collider that is nearest.
  const auto of_cell = [&](const std::array<int, D>& cell, std::int64_t i,
                           std::vector<Exchange>& part) {
    const std::array<Real, D> area = obstacles.surface(i);
    double square = 0;
    for (const Real a : area) square += double(a * a);
    if (square == 0) return;
    Vec3 at = obstacles.low;
    for (std::size_t a = 0; a < D; ++a) at[static_cast<int>(a)] += dx * (cell[a] + 0.5);
    std::size_t c = 0;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t k = 0; k < colliders.size(); ++k) {
      const double d = colliders[k].signed_distance(at).value;
      if (d < least) least = d, c = k;
    }
    const geometry::SignedDistance d = colliders[c].signed_distance(at);
    Vec3 normal = d.gradient;
    if constexpr (D == 2) normal.z() = 0;
    if (!(normal.norm() > 0)) return;
    normal.normalize();
    const Vec3 on = at - d.value * normal;
    // Places in the flow, in cells.
    const auto place = [&](double cells_off) {
      std::array<double, D> x;
      for (std::size_t a = 0; a < D; ++a) {
        const int k = static_cast<int>(a);
        x[a] = (on[k] - obstacles.low[k]) / dx + cells_off * normal[k];
        x[a] = std::clamp(x[a], 0.0, double(layout.cells[a]));
      }
      return x;
    };
    // Beside what moves, cells that come and go make the pressure of the nearest one swing.
    const auto pressure = [&] {
      if (colliders[c].velocity.isZero(0) && colliders[c].angular_velocity.isZero(0)) {
        return q[usize(i)];
      }
      const double near = pressure_at<D>(layout, std::span<const double>(q), place(kNear));
      const double far = pressure_at<D>(layout, std::span<const double>(q), place(kFar));
      return near + (near - far) * kNear / (kFar - kNear);
    };
    const double there = pressure();
    Vec3 impulse = Vec3::Zero();
    for (std::size_t a = 0; a < D; ++a) {
      impulse[static_cast<int>(a)] = mass * there * double(area[a]);
    }
    if (shear > 0) {
      const auto beside = [&](double cells_off) {
        const std::array<double, D> x = place(cells_off);
        std::array<Real, D> y;
        for (std::size_t a = 0; a < D; ++a) y[a] = Real(x[a]);
        const std::array<Real, D> v = velocity_at<Real, D>(layout, u, y);
        Vec3 relative = -colliders[c].surface_velocity(on + cells_off * dx * normal);
        if constexpr (D == 2) relative.z() = 0;
        for (std::size_t a = 0; a < D; ++a) relative[static_cast<int>(a)] += double(v[a]);
        return relative;
      };
      const Vec3 slope = (beside(kNear) * (kFar * kFar) - beside(kFar) * (kNear * kNear)) /
                         (kNear * kFar * (kFar - kNear));
      const Vec3 along = slope - normal.dot(slope) * normal;
      const double heavier = density.empty() ? 1 : double(density[usize(i)]);
      impulse += heavier * mass / dx * shear * std::sqrt(square) * along;
    }
    part[c].add(on - colliders[c].position(), impulse);
  };
  const Block<D> block = all_cells(layout);
  std::vector<std::vector<Exchange>> parts(usize((block.rows() + kRowsOfTask - 1) / kRowsOfTask));
  parallel_for(
      block.rows(), kRowsOfTask,
      [&](std::int64_t first, std::int64_t last) {
        std::vector<Exchange>& part = parts[usize(first / kRowsOfTask)];
        part.resize(colliders.size());
        for (std::int64_t r = first; r < last; ++r) {
          std::array<int, D> cell = block.row(r);
          const std::int64_t begin = layout.index(cell);
          for (std::int64_t i = begin; i < begin + block.length(); ++i, ++cell[D - 1]) {
            if (cells[usize(i)] == Cell::kFluid) of_cell(cell, i, part);
          }
        }
      },
      threads);
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Exchange sum;
    for (const std::vector<Exchange>& part : parts) sum += part[c];
    obstacles.colliders[c].set_exchange(sum);
  }
}

template struct Stress<float, 2>;
template struct Stress<float, 3>;
template struct Stress<double, 2>;
template struct Stress<double, 3>;

}  // namespace substep::gridfluid
