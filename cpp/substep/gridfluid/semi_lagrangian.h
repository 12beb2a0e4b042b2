// Advection along the paths of the fluid: stable with any step.
//
// Stam, "Stable fluids", 1999: what is at x at the end of a step is what was where x came from, by
// linear interpolation: of first order, and smooths like a viscosity of about |u| dx (1 - c) / 2 or
// less at c cells a step. Selle, Fedkiw, Kim, Liu and Rossignac, "An unconditionally stable
// MacCormack method", 2008: where following a path there and back does not return what was there,
// half of the difference is the error, and is taken away: of second order in space; the result is
// held to what was around the place it came from.
#pragma once

#include <span>

#include "substep/gridfluid/flow_sides.h"
#include "substep/gridfluid/trace.h"

namespace substep::gridfluid {

template <class Real, int D>
class SemiLagrangian {
 public:
  explicit SemiLagrangian(const Layout<D>& layout) : layout_(layout) {}

  // What is at cells, or at the faces of an axis, a step later: `from` and `to` are different
  // arrays, ghosts of `from` and of u are filled. refill(x) fills those of another such array.
  // reach: a step over a cell [s/m].
  template <class Refill>
  void advect(const Velocity<Real, D>& u, double reach, int faces_of, const Block<D>& block,
              bool maccormack, std::span<const Real> from, std::span<Real> to, const Refill& refill,
              int threads);

 private:
  Layout<D> layout_;
  AlignedBuffer<Real> low_, high_, first_;  // of MacCormack's method, made when it is first used
};

template <class Real, int D>
template <class Refill>
void SemiLagrangian<Real, D>::advect(const Velocity<Real, D>& u, double reach, int faces_of,
                                     const Block<D>& block, bool maccormack,
                                     std::span<const Real> from, std::span<Real> to,
                                     const Refill& refill, int threads) {
  const Paths<Real, D> paths(layout_, u, reach);
  std::span<Real> first = to;
  if (maccormack) {
    for (auto* buffer : {&low_, &high_, &first_}) {
      if (buffer->size() != usize(layout_.size)) buffer->reset(usize(layout_.size));
    }
    first = {first_.data(), first_.size()};
    std::copy(from.begin(), from.end(), first.begin());  // what is not in the block
  }
  for_placed_rows(layout_, block, threads,
                  [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
                    for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) {
                      std::array<Real, D> x;
                      const bool inside = paths.follow(cell, i, faces_of, Real(-1), x);
                      const Between<Real, D> at = between<Real, D>(layout_, x, faces_of);
                      const Real value = interpolate(layout_, from, at);
                      first[usize(i)] = value;
                      if (!maccormack) continue;
                      std::array<Real, 2> range{value, value};
                      if (inside) range = extremes(layout_, from, at);
                      low_[usize(i)] = range[0], high_[usize(i)] = range[1];
                    }
                  });
  if (!maccormack) return;
  refill(first);
  for_placed_rows(
      layout_, block, threads, [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i, ++cell[D - 1]) {
          std::array<Real, D> x;
          paths.follow(cell, i, faces_of, Real(1), x);
          const Real back = interpolate(layout_, first, between<Real, D>(layout_, x, faces_of));
          const Real value = first[usize(i)] + (from[usize(i)] - back) / 2;
          to[usize(i)] = std::max(low_[usize(i)], std::min(high_[usize(i)], value));
        }
      });
}

}  // namespace substep::gridfluid
