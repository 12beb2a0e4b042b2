// Numbers between those of a grid, one at a time.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/pressure/projection.h"

namespace substep::gridfluid {

// Where a point is between the numbers of an array: the lowest of the 2^D around it, and how far it
// is from that to the next [cells].
template <class Real, int D>
struct Between {
  std::int64_t base;
  std::array<Real, D> part;
};

// x: in cells from the lowest corner of the box, within it. faces_of: the axis of the faces, or -1
// for numbers in the middle of cells.
template <class Real, int D>
Between<Real, D> between(const Layout<D>& layout, const std::array<Real, D>& x, int faces_of) {
  Between<Real, D> at;
  at.base = layout.first;
  for (std::size_t b = 0; b < D; ++b) {
    const bool own = static_cast<int>(b) == faces_of;
    const Real y = own ? x[b] : x[b] - Real(0.5);
    const Real low = std::clamp(std::floor(y), Real(own ? 0 : -1), Real(layout.cells[b] - 1));
    at.base += static_cast<std::int64_t>(low) * layout.stride[b];
    at.part[b] = y - low;
  }
  return at;
}

template <class Real, int D, class T>
Real interpolate(const Layout<D>& layout, const T& f, const Between<Real, D>& at) {
  const auto line = [&](std::int64_t i) {
    const Real a = f[usize(i)], b = f[usize(i + 1)];
    return a + at.part[D - 1] * (b - a);
  };
  const auto plane = [&](std::int64_t i) {
    const Real a = line(i), b = line(i + layout.stride[D - 2]);
    return a + at.part[D - 2] * (b - a);
  };
  if constexpr (D == 2) {
    return plane(at.base);
  } else {
    const Real a = plane(at.base), b = plane(at.base + layout.stride[0]);
    return a + at.part[0] * (b - a);
  }
}

// Of the faces.
template <class Real, int D>
std::array<Real, D> velocity_at(const Layout<D>& layout, const Velocity<Real, D>& u,
                                const std::array<Real, D>& x) {
  std::array<Real, D> v;
  for (int a = 0; a < D; ++a) {
    v[usize(a)] = interpolate(layout, u[usize(a)], between<Real, D>(layout, x, a));
  }
  return v;
}

}  // namespace substep::gridfluid
