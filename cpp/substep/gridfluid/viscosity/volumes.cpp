#include "substep/gridfluid/viscosity/volumes.h"

#include <algorithm>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

namespace substep::gridfluid {
namespace {

constexpr double kFar = 2;  // cells from the surface, where all of a cell is on one side

// Of a half-cell cube, from the distance in its middle.
template <class Real>
Real filled(Real distance) {
  return std::clamp(Real(0.5) - 2 * distance, Real(0), Real(1));
}

}  // namespace

template <class Real, int D>
Volumes<Real, D>::Volumes(const Layout<D>& layout) : layout_(layout) {
  for (unsigned set = 0; set < kParts; ++set) {
    below_[set] = 0;
    for (std::size_t a = 0; a < D; ++a)
      if (set >> a & 1) below_[set] += layout.stride[a];
  }
}

template <class Real, int D>
void Volumes<Real, D>::find(const Obstacles<Real, D>& obstacles, std::span<const Real> phi,
                            int threads) {
  if (parts_.size() == 0) assign(parts_, layout_.size, Parts{});
  // At a place a quarter of a cell towards a corner, linear between 2^D numbers: those nearer along
  // each axis count 3/4, those further 1/4.
  const auto between = [](const auto& at) {
    Real sum = 0;
    for (unsigned k = 0; k < kParts; ++k) {
      Real weight = 1;
      for (std::size_t a = 0; a < D; ++a) weight *= k >> a & 1 ? Real(0.25) : Real(0.75);
      sum += weight * at(k);
    }
    return sum;
  };
  const auto steps = [&](unsigned axes, unsigned upper) {  // up along some of the axes, else down
    return below_[axes & upper] - below_[axes & ~upper];
  };
  const std::span<const Real> distance =
      obstacles.any() ? obstacles.distance() : std::span<const Real>();
  for_rows(layout_, all_cells(layout_), threads, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      Parts& parts = parts_[usize(i)];
      const Real level = phi[usize(i)];
      parts.fill(Real(level < 0 ? 1 : 0));
      if (std::abs(level) < Real(kFar)) {
        for (unsigned p = 0; p < kParts; ++p)
          parts[p] = filled(between([&](unsigned k) { return phi[usize(i + steps(k, p))]; }));
      }
      if (distance.empty() || level > Real(kFar) || obstacles.at_centre(i) > Real(kFar)) continue;
      for (unsigned p = 0; p < kParts; ++p) {
        parts[p] *=
            filled(-between([&](unsigned k) { return distance[usize(i + below_[p ^ k])]; }));
      }
    }
  });
  wrap(layout_, std::span<Parts>(parts_.data(), parts_.size()), threads);
}

template class Volumes<float, 2>;
template class Volumes<float, 3>;
template class Volumes<double, 2>;
template class Volumes<double, 3>;

}  // namespace substep::gridfluid
