// What the terms that act on velocities see of a fluid: rows in cell order and who is near whom.
//
// Every pair (i, j) gives to i what it takes from j, so each term conserves linear momentum to
// rounding; those whose forces act along x_i - x_j conserve angular momentum too. The volume of a
// particle is that at rest: the density solver keeps it there, and at a free surface, where sums
// lack half of their neighbours, it is not blown up as m / rho would be.
#pragma once

#include <cstdint>
#include <span>

#include "substep/core/point_lanes.h"
#include "substep/geometry/neighbours.h"
#include "substep/pbf/kernels.h"

namespace substep::pbf {

template <class Real>
struct Neighbourhood {
  std::span<const Point<Real>> x;           // [m], w: inverse mass m_0 / m; row n: far away
  std::span<const Point<Real>> v;           // [m/s]; row n: anything finite
  const geometry::Neighbours<Real>& lists;  // full, without i itself
  Real h;                                   // support of the kernels [m]
  Real volume;                              // of every particle at rest [m^3], in 2D [m^2]
  int dimension;                            // 2 or 3
  int threads;

  std::int64_t size() const { return static_cast<std::int64_t>(x.size()) - 1; }
};

// W = kernel_scale CubicSpline::value(q), dW/dr = kernel_scale CubicSpline::slope(q) / h. Whatever
// kernel the density is made of, these terms take the cubic spline.
template <class Real>
Real kernel_scale(const Neighbourhood<Real>& near) {
  const Real volume = near.dimension == 2 ? near.h * near.h : near.h * near.h * near.h;
  return Real(CubicSpline::value_scale(near.dimension)) / volume;
}

// The geometry of the pairs of i with as many neighbours as V has lanes.
template <class V>
struct PairLanes {
  V x, y, z;                  // x_i - x_j
  V r2;                       // |x_i - x_j|^2, a little more than 0
  V inverse_r;                // 1 / r
  V q;                        // r / h
  V inverse_mass;             // m_0 / m_j
  const std::int32_t* index;  // j
};

// body(pair) for all neighbours of i. Coincident particles have r = 1e-6 h and no direction.
template <class V, class Real, class Body>
SUBSTEP_INLINE void for_pairs(const Neighbourhood<Real>& near, std::int64_t i, Body&& body) {
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  const Point<Real> xi = near.x[i];
  const Real per_h = 1 / near.h, tiny = Real(1e-12) * near.h * near.h;
  const geometry::NeighbourList list = near.lists[i];
  for (int k = 0; k < list.count; k += kLanes) {
    const PointLanes<V> xj = load_points<V>(near.x.data(), list.indices + k);
    PairLanes<V> pair;
    pair.x = xi.x - xj.x, pair.y = xi.y - xj.y, pair.z = xi.z - xj.z;
    pair.r2 = fma<V>(pair.x, pair.x, fma<V>(pair.y, pair.y, fma<V>(pair.z, pair.z, tiny)));
    pair.inverse_r = inverse_sqrt<V>(pair.r2);
    pair.q = pair.r2 * pair.inverse_r * per_h;
    pair.inverse_mass = xj.w;
    pair.index = list.indices + k;
    body(pair);
  }
}

}  // namespace substep::pbf
