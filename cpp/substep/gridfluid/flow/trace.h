// Paths of the fluid through a staggered grid, and numbers between those of a grid.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

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

// The smallest and the largest of the 2^D that count: at a number itself its neighbours do not, so
// that it is the same seen from either side.
template <class Real, int D, class T>
std::array<Real, 2> extremes(const Layout<D>& layout, const T& f, const Between<Real, D>& at) {
  constexpr Real kNone = Real(1e-4);
  Real low = std::numeric_limits<Real>::infinity(), high = -low;
  for (int corner = 0; corner < (1 << D); ++corner) {
    std::int64_t i = at.base;
    bool counts = true;
    for (std::size_t b = 0; b < D; ++b) {
      const bool upper = (corner >> b & 1) != 0;
      counts &= (upper ? at.part[b] : 1 - at.part[b]) > kNone;
      if (upper) i += layout.stride[b];
    }
    if (counts) low = std::min(low, f[usize(i)]), high = std::max(high, f[usize(i)]);
  }
  return {low, high};
}

template <class Real, int D>
class Paths {
 public:
  // reach: a step over a cell [s/m].
  Paths(const Layout<D>& layout, const Velocity<Real, D>& u, double reach)
      : layout_(layout), u_(u), reach_(Real(reach)) {}

  // Where the middle of a cell, or of the face below it, goes in a step (way = 1), or came from
  // (way = -1), through the velocities as they are; false where it would leave the box, at whose
  // side it then is. Runge and Kutta's method of third order by Ralston, as in Bridson, "Fluid
  // simulation for computer graphics", 2015, p. 33.
  bool follow(const std::array<int, D>& cell, std::int64_t i, int faces_of, Real way,
              std::array<Real, D>& x) const {
    for (std::size_t b = 0; b < D; ++b) {
      x[b] = Real(cell[b]) + (static_cast<int>(b) == faces_of ? Real(0) : Real(0.5));
    }
    const Real h = way * reach_;
    const std::array<Real, D> k1 = there(i, faces_of);
    std::array<Real, D> at;
    for (std::size_t b = 0; b < D; ++b) at[b] = x[b] + h / 2 * k1[b];
    keep_inside(at);
    const std::array<Real, D> k2 = velocity(at);
    for (std::size_t b = 0; b < D; ++b) at[b] = x[b] + h * Real(0.75) * k2[b];
    keep_inside(at);
    const std::array<Real, D> k3 = velocity(at);
    for (std::size_t b = 0; b < D; ++b) {
      x[b] += h * (Real(2.0 / 9) * k1[b] + Real(3.0 / 9) * k2[b] + Real(4.0 / 9) * k3[b]);
    }
    return keep_inside(x);
  }

  std::array<Real, D> velocity(const std::array<Real, D>& x) const {
    std::array<Real, D> v;
    for (int a = 0; a < D; ++a) {
      v[usize(a)] = interpolate(layout_, u_[usize(a)], between<Real, D>(layout_, x, a));
    }
    return v;
  }

 private:
  // The velocity in the middle of a cell or face: of the faces around.
  std::array<Real, D> there(std::int64_t i, int faces_of) const {
    std::array<Real, D> v;
    for (std::size_t b = 0; b < D; ++b) {
      const auto pair = [&](std::int64_t j) {
        return u_[b][usize(j)] + u_[b][usize(j + layout_.stride[b])];
      };
      if (static_cast<int>(b) == faces_of) {
        v[b] = u_[b][usize(i)];
      } else if (faces_of < 0) {
        v[b] = pair(i) / 2;
      } else {
        v[b] = (pair(i) + pair(i - layout_.stride[usize(faces_of)])) / 4;
      }
    }
    return v;
  }

  bool keep_inside(std::array<Real, D>& x) const {
    bool inside = true;
    for (std::size_t b = 0; b < D; ++b) {
      const Real n = Real(layout_.cells[b]);
      if (layout_.periodic[b]) {
        x[b] -= n * std::floor(x[b] / n);
        if (!(x[b] >= 0 && x[b] <= n)) x[b] = 0;  // no number of it was left
      } else if (!(x[b] >= 0 && x[b] <= n)) {
        x[b] = x[b] > n ? n : Real(0);
        inside = false;
      }
    }
    return inside;
  }

  const Layout<D>& layout_;
  const Velocity<Real, D>& u_;
  Real reach_;
};

}  // namespace substep::gridfluid
