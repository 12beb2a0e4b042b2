#include "substep/gridfluid/flow/flow_sides.h"

#include <algorithm>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"

namespace substep::gridfluid {
namespace {

// Cells next to a side, the ghosts of other axes included: each(cell, inside, beyond).
template <int D, class Each>
void for_beside(const Layout<D>& layout, std::size_t axis, std::size_t end, int threads,
                const Each& each) {
  constexpr std::int64_t kMany = 4096, kSome = 1024;  // cells that are worth threads, and a task
  Block<D> block;
  for (std::size_t b = 0; b < D; ++b) block.from[b] = -1, block.to[b] = layout.cells[b] + 1;
  block.from[axis] = end == 0 ? 0 : layout.cells[axis] - 1;
  block.to[axis] = block.from[axis] + 1;
  const std::int64_t out = end == 0 ? -layout.stride[axis] : layout.stride[axis];
  for_placed_rows(
      layout, block, block.rows() * block.length() < kMany ? 1 : threads,
      [&](std::array<int, D> cell, std::int64_t first, std::int64_t last) {
        for (std::int64_t i = first; i < last; ++i, ++cell[D - 1]) each(cell, i, i + out);
      },
      std::max<std::int64_t>(kSome / block.length(), 1));
}

}  // namespace

template <class Real, int D>
Block<D> SideGhosts<Real, D>::free_faces(std::size_t axis) const {
  Block<D> block = all_faces(layout_, axis);
  if (is(axis, 0, SideKind::kPeriodic)) {
    --block.to[axis];
  } else {
    if (!is(axis, 0, SideKind::kOpen)) ++block.from[axis];
    if (!is(axis, 1, SideKind::kOpen)) --block.to[axis];
  }
  return block;
}

template <class Real, int D>
Block<D> SideGhosts<Real, D>::inner_faces(std::size_t axis) const {
  Block<D> block = free_faces(axis);
  if (is(axis, 0, SideKind::kOpen)) ++block.from[axis];
  if (is(axis, 1, SideKind::kOpen)) --block.to[axis];
  return block;
}

// Faces of a component that is tangential stand between two of the side's.
template <class Real, int D>
double SideGhosts<Real, D>::given(std::size_t axis, std::size_t end, const std::array<int, D>& cell,
                                  std::size_t a) const {
  const std::vector<double>& velocity = sides_[axis][end].velocity;
  if (velocity.empty()) return 0;
  const auto at = [&](int back) {
    std::size_t number = 0;
    for (std::size_t b = 0; b < D; ++b) {
      if (b == axis) continue;
      const int n = layout_.cells[b], c = cell[b] - (b == a ? back : 0);
      number = number * usize(n) + usize(std::clamp(c, 0, n - 1));
    }
    return velocity[number * D + a];
  };
  return a == axis ? at(0) : (at(0) + at(1)) / 2;
}

template <class Real, int D>
void SideGhosts<Real, D>::set_normal(std::span<Real> u, std::size_t a, int threads) const {
  for (std::size_t end = 0; end < 2; ++end) {
    if (is(a, end, SideKind::kOpen) || is(a, end, SideKind::kPeriodic)) continue;
    for_beside(layout_, a, end, threads, [&](const auto& cell, std::int64_t inside, std::int64_t) {
      const std::int64_t face = end == 0 ? inside : inside + layout_.stride[a];
      u[usize(face)] = Real(given(a, end, cell, a));
    });
  }
}

template <class Real, int D>
void SideGhosts<Real, D>::fill_velocity(std::span<Real> u, std::size_t a, bool given_too,
                                        int threads) const {
  for (std::size_t b = 0; b < D; ++b) {
    if (is(b, 0, SideKind::kPeriodic) || b == a) continue;
    for (std::size_t end = 0; end < 2; ++end) {
      const Side& side = sides_[b][end];
      const bool held =
          side.kind == SideKind::kInflow || (side.kind == SideKind::kWall && !side.slip);
      for_beside(layout_, b, end, threads,
                 [&](const auto& cell, std::int64_t inside, std::int64_t beyond) {
                   const Real at = held && given_too ? Real(2 * given(b, end, cell, a)) : Real(0);
                   u[usize(beyond)] = held ? at - u[usize(inside)] : u[usize(inside)];
                 });
    }
  }
  wrap(layout_, u, threads);
}

// Whether a side holds the k-th scalar: what flows out takes along what it is.
template <class Real>
bool holds(const Side& side, std::size_t k, Real outward) {
  if (side.kind == SideKind::kWall) return side.holds[k];
  return side.kind == SideKind::kOpen ? outward < 0 : outward <= 0;
}

template <class Real, int D>
void SideGhosts<Real, D>::fill_scalar(std::span<Real> x, std::size_t k, double diffusivity,
                                      const Velocity<Real, D>& u, int threads) const {
  for (std::size_t b = 0; b < D; ++b) {
    if (is(b, 0, SideKind::kPeriodic)) continue;
    for (std::size_t end = 0; end < 2; ++end) {
      const Side& side = sides_[b][end];
      for_beside(
          layout_, b, end, threads, [&](const auto&, std::int64_t inside, std::int64_t beyond) {
            const std::int64_t face = end == 0 ? inside : beyond;
            const Real outward = end == 0 ? -u[b][usize(face)] : u[b][usize(face)];
            const Real in = x[usize(inside)];
            Real ghost = in;
            if (holds(side, k, outward)) {
              ghost = Real(2 * (side.kind == SideKind::kOpen ? ambient_[k] : side.scalar[k])) - in;
            } else if (side.kind == SideKind::kWall && diffusivity > 0) {
              ghost = in + Real(side.scalar[k] * dx_ / diffusivity);
            }
            x[usize(beyond)] = ghost;
          });
    }
  }
  wrap(layout_, x, threads);
}

template <class Real, int D>
void SideGhosts<Real, D>::fill_scalar_change(std::span<Real> x, std::size_t k,
                                             const Velocity<Real, D>& u, int threads) const {
  for (std::size_t b = 0; b < D; ++b) {
    if (is(b, 0, SideKind::kPeriodic)) continue;
    for (std::size_t end = 0; end < 2; ++end) {
      const Side& side = sides_[b][end];
      for_beside(layout_, b, end, threads,
                 [&](const auto&, std::int64_t inside, std::int64_t beyond) {
                   const std::int64_t face = end == 0 ? inside : beyond;
                   const Real outward = end == 0 ? -u[b][usize(face)] : u[b][usize(face)];
                   const Real in = x[usize(inside)];
                   x[usize(beyond)] = holds(side, k, outward) ? -in : in;
                 });
    }
  }
  wrap(layout_, x, threads);
}

template class SideGhosts<float, 2>;
template class SideGhosts<float, 3>;
template class SideGhosts<double, 2>;
template class SideGhosts<double, 3>;

}  // namespace substep::gridfluid
