// Advection along the paths of the fluid: stable with any step.
//
// Stam, "Stable fluids", 1999: what is at x at the end of a step is what was where x came from, by
// linear interpolation: of first order, and smooths like a viscosity of about |u| dx (1 - c) / 2 or
// less at c cells a step. Selle, Fedkiw, Kim, Liu and Rossignac, "An unconditionally stable
// MacCormack method", 2008: where following a path there and back does not return what was there,
// half of the difference is the error, and is taken away: of second order in space; the result is
// held to what was around the place it came from.
//
// One path is followed from the middle of each cell, by Runge and Kutta's method of third order by
// Ralston, as in Bridson, "Fluid simulation for computer graphics", 2015, p. 33. A face goes as far
// as the mean of the two cells beside it, which is of second order in the size of cells too.
#pragma once

#include <array>
#include <span>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/loops.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

template <class Real, int D>
class SemiLagrangian {
 public:
  explicit SemiLagrangian(const Layout<D>& layout) : layout_(layout) {}

  // Finds the paths of a step through velocities whose ghosts are filled. reach: a step over a cell
  // [s/m].
  void follow(const Velocity<Real, D>& u, double reach, bool maccormack, int threads);
  // What is at cells, or at the faces of an axis, a step later: `from` and `to` are different
  // arrays, and ghosts of `from` are filled. refill(x) fills those of another such array, and what
  // is in it but not in the block.
  template <class Refill>
  void advect(int faces_of, const Block<D>& block, std::span<const Real> from, std::span<Real> to,
              const Refill& refill, int threads) {
    if (maccormack_) {
      const std::span<Real> first(first_.data(), first_.size());
      go_back(faces_of, block, from, first, threads);
      refill(first);
      correct(faces_of, block, from, to, threads);
    } else {
      go_back(faces_of, block, from, to, threads);
    }
  }

 private:
  void go_back(int faces_of, const Block<D>& block, std::span<const Real> from, std::span<Real> to,
               int threads);
  void correct(int faces_of, const Block<D>& block, std::span<const Real> from, std::span<Real> to,
               int threads);

  Layout<D> layout_;
  bool maccormack_ = false;
  // Made when they are first used: how far the middle of a cell came and goes [cells], and, of
  // MacCormack's method, what comes of a path back and what was around its end.
  std::array<AlignedBuffer<Real>, D> back_, forth_;
  AlignedBuffer<Real> first_, low_, high_;
};

extern template class SemiLagrangian<float, 2>;
extern template class SemiLagrangian<float, 3>;
extern template class SemiLagrangian<double, 2>;
extern template class SemiLagrangian<double, 3>;

}  // namespace substep::gridfluid
