// Smoothing kernels W(r) with a compact support of radius h, of integral 1 over the space of
// dimension 2 or 3. With q = r / h in [0, 1] and (a)_+ = max(a, 0):
//
// Cubic spline (Monaghan, "Smoothed particle hydrodynamics", 1992; in the form of Koschier et al.,
// "Smoothed particle hydrodynamics techniques", Eurographics 2019, eq. 4):
//   W = s [2 (1 - q)_+^3 - 8 (1/2 - q)_+^3],   dW/dr = s / h [-6 (1 - q)_+^2 + 24 (1/2 - q)_+^2],
//   s = 40 / (7 pi h^2) in 2D, 8 / (pi h^3) in 3D.
//
// Poly6 for the density and the gradient of the spiky kernel (Mueller et al., "Particle-based fluid
// simulation for interactive applications", 2003, eqs. 20 and 21), as Macklin and Mueller,
// "Position based fluids", 2013, take them: the gradient is not that of the density, so corrections
// are not quite along it, but it does not vanish for close particles.
//   W = s (1 - q^2)_+^3,   s = 4 / (pi h^2) in 2D, 315 / (64 pi h^3) in 3D,
//   dW_spiky/dr = -3 t / h (1 - q)_+^2,   t = 10 / (pi h^2) in 2D, 15 / (pi h^3) in 3D.
//
// A kernel here is the part in brackets as functions over lanes: value(q) and slope(q), and their
// factors value_scale(dimension) = s h^D and slope_scale(dimension): W = s value, W' = s' slope /
// h.
#pragma once

#include <numbers>

#include "substep/core/lanes.h"

namespace substep::pbf {

template <class V>
SUBSTEP_INLINE V positive_part(const V& a) {
  return a > 0 ? a : V{};
}

struct CubicSpline {
  static constexpr double value_scale(int dimension) {
    return dimension == 2 ? 40 / (7 * std::numbers::pi) : 8 / std::numbers::pi;
  }
  static constexpr double slope_scale(int dimension) { return value_scale(dimension); }

  template <class V>
  static SUBSTEP_INLINE V value(const V& q) {
    const V a = positive_part<V>(1 - q), b = positive_part<V>(Lane<V>(0.5) - q);
    return 2 * (a * a * a) - 8 * (b * b * b);
  }
  template <class V>
  static SUBSTEP_INLINE V slope(const V& q) {
    const V a = positive_part<V>(1 - q), b = positive_part<V>(Lane<V>(0.5) - q);
    return fma<V>(Lane<V>(24), b * b, -6 * (a * a));
  }
};

struct Poly6Spiky {
  static constexpr double value_scale(int dimension) {
    return dimension == 2 ? 4 / std::numbers::pi : 315 / (64 * std::numbers::pi);
  }
  static constexpr double slope_scale(int dimension) {
    return dimension == 2 ? 10 / std::numbers::pi : 15 / std::numbers::pi;
  }

  template <class V>
  static SUBSTEP_INLINE V value(const V& q) {
    const V a = positive_part<V>(1 - q * q);
    return a * a * a;
  }
  template <class V>
  static SUBSTEP_INLINE V slope(const V& q) {
    const V a = positive_part<V>(1 - q);
    return -3 * (a * a);
  }
};

}  // namespace substep::pbf
