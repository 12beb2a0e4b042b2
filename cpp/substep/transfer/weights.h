// B-splines of order 1, 2 and 3, which pass numbers between particles and the nodes of a grid.
//
// Lengths are in cells. Along an axis a particle at x reaches order + 1 nodes with weights N(x -
// x_i) that sum to 1 (mass is passed on exactly) and whose first moment is x (so are linear
// fields): Jiang et al., "The material point method for simulating continuum materials", SIGGRAPH
// course, 2016, eq. 122 (cubic), 123 (quadratic); Steffen, Kirby, Berzins, "Analysis and reduction
// of quadrature errors in the material point method", 2008.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "substep/core/usize.h"
#include "substep/transfer/blocks.h"

namespace substep::transfer {

// Nodes `first` to `first + order`: their weights, and d weight / d x [1/cell].
template <class Real, int kOrder>
struct Spline {
  static_assert(kOrder >= 1 && kOrder <= 3);
  static constexpr int kNodes = kOrder + 1;
  std::int32_t first;
  Real distance;  // x - first
  Real w[kNodes], g[kNodes];
};

template <int kOrder, class Real>
inline Spline<Real, kOrder> spline(Real x) {
  // The node left of x, or for order 2 the one left of the nearest.
  const Real first = std::floor(kOrder == 2 ? x - Real(0.5) : x) - Real(kOrder == 3);
  const Real f = x - first;
  const std::int32_t i = static_cast<std::int32_t>(first);
  if constexpr (kOrder == 1) {
    return {i, f, {1 - f, f}, {-1, 1}};
  } else if constexpr (kOrder == 2) {
    const Real a = Real(1.5) - f, b = f - 1, c = f - Real(0.5);
    return {i, f, {a * a / 2, Real(0.75) - b * b, c * c / 2}, {-a, -2 * b, c}};
  } else {
    const Real a = 2 - f, b = f - 1;  // b in [0, 1): x - (first + 1), a = 1 - b
    const auto inner = [](Real t) { return t * t * (t / 2 - 1) + Real(2) / 3; };
    const auto slope = [](Real t) { return t * (Real(1.5) * t - 2); };
    return {i,
            f,
            {a * a * a / 6, inner(b), inner(a), b * b * b / 6},
            {-a * a / 2, slope(b), -slope(a), b * b / 2}};
  }
}

// Second moment D = sum w (x_i - x)^2 along an axis [cells^2]: constant for order 2 and 3 (Jiang et
// al. 2016, after eq. 176). For order 1 it is f (1 - f) and 0 at nodes; but D^-1 w (x_i - x) is the
// gradient of the weight there, without a singularity (Jiang et al., "The affine particle-in-cell
// method", 2015).
template <int kOrder>
inline constexpr double kSecondMoment = kOrder == 2 ? 1.0 / 4 : 1.0 / 3;

template <class Real, int kOrder>
inline Real second_moment(const Spline<Real, kOrder>& s) {
  if constexpr (kOrder == 1) {
    return s.w[0] * s.w[1];
  } else {
    return Real(kSecondMoment<kOrder>);
  }
}

// D^-1 w_k (x_k - x) of node k along the spline's own axis.
template <class Real, int kOrder>
inline Real affine_weight(const Spline<Real, kOrder>& s, int k) {
  if constexpr (kOrder == 1) {
    return s.g[k];
  } else {
    return Real(1 / kSecondMoment<kOrder>) * s.w[k] * (Real(k) - s.distance);
  }
}

// Node k's part in means over the corners of the cells between the nodes, where these weigh as by
// the spline of one order less, n: half of the two cells next to it. g_k = n_(k-1) - n_k.
template <class Real, int kOrder>
inline Real corner_weight(const Spline<Real, kOrder>& s, int k) {
  Real before = 0, after = 0;
  for (int j = 0; j <= k; ++j) {
    before = after;
    after -= s.g[j];
  }
  return (before + after) / 2;
}

// Where the nodes of component c of a field lie along axis d, in cells from integers.
struct Collocated {
  static constexpr double offset(int, int) { return 0; }
};
// Marker-and-cell: cell i spans [i, i + 1], component c lives on the faces across axis c (Harlow,
// Welch 1965).
struct Staggered {
  static constexpr double offset(int c, int d) { return c == d ? 0 : 0.5; }
};

// The stencil of one component in D dimensions: products of splines.
template <class Real, int kOrder, int D>
struct Weights {
  static constexpr int kNodes =
      D == 3 ? (kOrder + 1) * (kOrder + 1) * (kOrder + 1) : (kOrder + 1) * (kOrder + 1);
  std::array<Spline<Real, kOrder>, D> axis;

  using Offsets = std::array<int, D>;  // of a node, from the first one
  static constexpr Offsets offsets(int node) {
    Offsets k{};
    for (int d = D - 1; d >= 0; --d, node /= kOrder + 1) {
      k[usize(d)] = node % (kOrder + 1);
    }
    return k;
  }
  Index<D> node(const Offsets& k) const {
    Index<D> i;
    for (std::size_t d = 0; d < D; ++d) i[d] = axis[d].first + k[d];
    return i;
  }
  // From the particle to the node [cells].
  std::array<Real, D> arm(const Offsets& k) const {
    std::array<Real, D> r;
    for (std::size_t d = 0; d < D; ++d) r[d] = Real(k[d]) - axis[d].distance;
    return r;
  }
  Real weight(const Offsets& k) const { return product(k, D, 0); }
  // grad w = d w / d x_p [1/cell].
  std::array<Real, D> gradient(const Offsets& k) const {
    std::array<Real, D> g;
    for (std::size_t d = 0; d < D; ++d) g[d] = product(k, d, axis[d].g[k[d]]);
    return g;
  }
  // D^-1 w (x_i - x_p) [1/cell]: what the affine fit of a field weighs it with.
  std::array<Real, D> affine(const Offsets& k) const {
    std::array<Real, D> a;
    for (std::size_t d = 0; d < D; ++d) a[d] = product(k, d, affine_weight(axis[d], k[d]));
    return a;
  }

 private:
  // Product over the axes of their weights, with `factor` in the place of axis `replaced`.
  Real product(const Offsets& k, std::size_t replaced, Real factor) const {
    Real w = replaced == 0 ? factor : axis[0].w[k[0]];
    for (std::size_t d = 1; d < D; ++d) w *= d == replaced ? factor : axis[d].w[k[d]];
    return w;
  }
};

// The stencil of component c of a field on Grid (Collocated, Staggered) around x.
template <class Grid, int kOrder, class Real, std::size_t D>
inline Weights<Real, kOrder, static_cast<int>(D)> weights(const std::array<Real, D>& x, int c) {
  Weights<Real, kOrder, static_cast<int>(D)> result;
  for (std::size_t d = 0; d < D; ++d) {
    result.axis[d] = spline<kOrder>(x[d] - Real(Grid::offset(c, static_cast<int>(d))));
  }
  return result;
}

}  // namespace substep::transfer
