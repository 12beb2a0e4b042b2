#include "substep/gridfluid/flow/stress.h"

#include <algorithm>

#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

constexpr double kWhole = 2, kNone = 6;  // cells from an obstacle: where w is 1, and 0
constexpr std::int64_t kCellsOfTask = 512;

using geometry::Collider;
using geometry::Exchange;

}  // namespace

// Cells with a weight, each for the obstacle that is nearest.
template <class Real, int D>
void Stress<Real, D>::find(const Layout<D>& layout, const Obstacles<Real, D>& obstacles,
                           std::span<const Cell> cells, int threads) {
  near_.clear();
  if (!obstacles.any()) return;
  constexpr double kUnsure = 4;  // far from surfaces Obstacles knows distances roughly
  const Block<D> block = all_cells(layout);
  std::vector<std::vector<Near>> parts(usize((block.rows() + kRowsOfTask - 1) / kRowsOfTask));
  parallel_for(
      block.rows(), kRowsOfTask,
      [&](std::int64_t first, std::int64_t last) {
        std::vector<Near>& part = parts[usize(first / kRowsOfTask)];
        for (std::int64_t r = first; r < last; ++r) {
          const std::int64_t begin = layout.index(block.row(r));
          for (std::int64_t i = begin; i < begin + block.length(); ++i) {
            const auto roughly = double(obstacles.at_centre(i));
            if (cells[usize(i)] != Cell::kFluid || roughly > kNone + kUnsure) continue;
            const Vec3 at = obstacles.middle(i);
            const std::size_t c = obstacles.nearest(at);
            const double off = obstacles.colliders[c].signed_distance(at).value / obstacles.dx;
            if (off >= kNone) continue;
            part.push_back({.cell = i,
                            .collider = c,
                            .weight = std::min((kNone - off) / (kNone - kWhole), 1.0),
                            .room = std::clamp(roughly + 0.5, 0.0, 1.0)});
          }
        }
      },
      threads);
  for (const std::vector<Near>& part : parts) near_.insert(near_.end(), part.begin(), part.end());
}

// What passes through a face of a cell upward, of a unit of mass: momentum carried along, pressure
// and shear.
template <class Real, int D>
Vec3 Stress<Real, D>::through(const Layout<D>& layout, std::span<const Cell> cells,
                              const Step& step, std::int64_t i, std::size_t axis,
                              bool upper) const {
  const std::array<std::int64_t, D>& s = layout.stride;
  const Velocity<Real, D>& u = step.after;
  const std::int64_t f = upper ? i + s[axis] : i;  // the face, and the cell above it
  const std::int64_t other = upper ? f : i - s[axis], behind = upper ? i - s[axis] : i + s[axis];
  const auto is_fluid = [&](std::int64_t j) { return cells[usize(j)] == Cell::kFluid; };
  const int place = layout.cell(i)[axis];
  const bool side =
      !layout.periodic[axis] && (upper ? place + 1 == layout.cells[axis] : place == 0);
  const auto pressure = [&] {
    const double here = step.q[usize(i)];
    if (!side) return (here + step.q[usize(other)]) / 2;
    if (cells[usize(other)] == Cell::kAir) return 0.0;
    const bool inner = layout.cells[axis] > 1 && is_fluid(behind);
    return inner ? here + (here - step.q[usize(behind)]) / 2 : here;
  };
  const double own = step.density_of(i);
  const double mean_density = (own + step.density_of(side ? i : other)) / 2;
  const auto along = double(u[axis][usize(f)]);
  Vec3 sum = Vec3::Zero();
  for (std::size_t b = 0; b < D; ++b) {
    double carried = along, slope = 0;
    if (b == axis) {
      if (!side) slope = double(u[axis][usize(f + s[axis])] - u[axis][usize(f - s[axis])]);
    } else {
      const auto mean = [&](std::int64_t j) {
        return double(u[b][usize(j)] + u[b][usize(j + s[b])]) / 2;
      };
      const double above = mean(f), below = mean(f - s[axis]);
      carried = (above + below) / 2;
      slope = above - below + double(u[axis][usize(f + s[b])] - u[axis][usize(f - s[b])]) / 2;
    }
    sum[static_cast<int>(b)] =
        own * step.courant * along * carried - mean_density * step.shear * slope;
  }
  sum[static_cast<int>(axis)] += pressure();
  return sum;
}

template <class Real, int D>
void Stress<Real, D>::push(const Layout<D>& layout, Obstacles<Real, D>& obstacles,
                           std::span<const Cell> cells, const Step& step, int threads) const {
  std::vector<Collider>& colliders = obstacles.colliders;
  const auto count = static_cast<std::int64_t>(near_.size());
  std::vector<std::vector<Exchange>> parts(usize((count + kCellsOfTask - 1) / kCellsOfTask));
  const auto of_cell = [&](const Near& near, std::vector<Exchange>& part) {
    const std::int64_t i = near.cell;
    const Vec3 arm = obstacles.middle(i) - colliders[near.collider].position();
    const double mass = near.weight * step.mass;
    Vec3 kept = Vec3::Zero();
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t above = i + layout.stride[a];
      for (const bool upper : {false, true}) {
        const auto open = double(obstacles.open(static_cast<int>(a))[usize(upper ? above : i)]);
        if (open == 0) continue;
        Vec3 on = arm;
        on[static_cast<int>(a)] += (upper ? 0.5 : -0.5) * obstacles.dx;
        const double inward = (upper ? -1 : 1) * open * mass;
        part[near.collider].add(on, inward * through(layout, cells, step, i, a, upper));
      }
      const auto sum = [&](const Velocity<Real, D>& u) {
        return double(u[a][usize(i)]) + double(u[a][usize(above)]);
      };
      kept[static_cast<int>(a)] = (sum(step.after) - sum(step.before)) / 2 - step.pull(i, a);
    }
    part[near.collider].add(arm, -near.room * step.density_of(i) * mass * kept);
  };
  parallel_for(
      count, kCellsOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Exchange>& part = parts[usize(begin / kCellsOfTask)];
        part.resize(colliders.size());
        for (std::int64_t k = begin; k < end; ++k) of_cell(near_[usize(k)], part);
      },
      threads);
  for (std::size_t c = 0; c < colliders.size(); ++c) {
    Exchange sum;
    for (const std::vector<Exchange>& part : parts) sum += part[c];
    colliders[c].set_exchange(sum);
  }
}

template class Stress<float, 2>;
template class Stress<float, 3>;
template class Stress<double, 2>;
template class Stress<double, 3>;

}  // namespace substep::gridfluid
