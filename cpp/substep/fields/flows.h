// Velocity fields in closed form. Each is dx/dt = velocity(at(t), x), for vectors of lanes: `at`
// holds what depends on time alone, computed once a stage; `trig` computes sin and cos together.
#pragma once

#include <array>
#include <cmath>
#include <numbers>

#include "substep/core/sincos.h"

namespace substep::fields {

struct Still {};  // of flows that do not depend on time

// u = omega x (x - center): in the plane omega = (0, 0, omega_z).
template <int kDim>
struct RigidRotation {
  static constexpr int kDimension = kDim;
  std::array<double, 3> omega{}, center{};  // [rad/s], [m]
  Still at(double) const { return {}; }
  template <class V, class Trig>
  SUBSTEP_INLINE void velocity(Still, const V* x, V* u, Trig&) const {
    using T = Lane<V>;
    const T wx = T(omega[0]), wy = T(omega[1]), wz = T(omega[2]);
    const V rx = x[0] - T(center[0]), ry = x[1] - T(center[1]);
    if constexpr (kDim == 2) {
      u[0] = -wz * ry;
      u[1] = wz * rx;
    } else {
      const V rz = x[2] - T(center[2]);
      u[0] = wy * rz - wz * ry;
      u[1] = wz * rx - wx * rz;
      u[2] = wx * ry - wy * rx;
    }
  }
};

// Simple shear: u_flow = rate * x_gradient, the other components 0.
template <int kDim>
struct Shear {
  static constexpr int kDimension = kDim;
  double rate = 1;  // [1/s]
  int flow = 0, gradient = 1;
  Still at(double) const { return {}; }
  template <class V, class Trig>
  SUBSTEP_INLINE void velocity(Still, const V* x, V* u, Trig&) const {
    using T = Lane<V>;
    const V along = T(rate) * x[gradient];
    for (int d = 0; d < kDim; ++d) u[d] = d == flow ? along : V{};
  }
};

// Taylor and Green 1937, Proc. R. Soc. A 158, 499 (the plane vortices, an exact solution of the
// Navier-Stokes equations): with F = U exp(-2 nu k^2 t),
// u = F sin(k x) cos(k y), v = -F cos(k x) sin(k y); stream function F/k sin(k x) sin(k y).
struct TaylorGreen {
  static constexpr int kDimension = 2;
  double amplitude = 1, wavenumber = 1, viscosity = 0;  // U [m/s], k [rad/m], nu [m^2/s]
  double at(double t) const {
    return amplitude * std::exp(-2 * viscosity * wavenumber * wavenumber * t);
  }
  template <class V, class Trig>
  SUBSTEP_INLINE void velocity(double factor, const V* x, V* u, Trig& trig) const {
    using T = Lane<V>;
    const T k = T(wavenumber), f = T(factor);
    V sx, cx, sy, cy;
    trig(k * x[0], sx, cx);
    trig(k * x[1], sy, cy);
    u[0] = f * (sx * cy);
    u[1] = -f * (cx * sy);
  }
};

// Arnold-Beltrami-Childress flow: Dombre et al. 1986, J. Fluid Mech. 167, 353, eq. (1.1).
struct Abc {
  static constexpr int kDimension = 3;
  double a = 1, b = 1, c = 1;  // [m/s]
  Still at(double) const { return {}; }
  template <class V, class Trig>
  SUBSTEP_INLINE void velocity(Still, const V* x, V* u, Trig& trig) const {
    using T = Lane<V>;
    V sx, cx, sy, cy, sz, cz;
    trig(x[0], sx, cx);
    trig(x[1], sy, cy);
    trig(x[2], sz, cz);
    u[0] = fma(T(a), sz, T(c) * cy);
    u[1] = fma(T(b), sx, T(a) * cz);
    u[2] = fma(T(c), sy, T(b) * cx);
  }
};

// Shadden, Lekien, Marsden 2005, Physica D 212, 271, eq. (50)-(52), on [0, 2] x [0, 1]:
// stream function A sin(pi f) sin(pi y), f = e x^2 + (1 - 2 e) x, e(t) = epsilon sin(omega t);
// u = -pi A sin(pi f) cos(pi y), v = pi A cos(pi f) sin(pi y) df/dx.
struct DoubleGyre {
  static constexpr int kDimension = 2;
  double amplitude = 0.1, epsilon = 0.25, omega = 2 * std::numbers::pi / 10;  // [m/s] [] [rad/s]
  double at(double t) const { return epsilon * std::sin(omega * t); }
  template <class V, class Trig>
  SUBSTEP_INLINE void velocity(double e_at_t, const V* x, V* u, Trig& trig) const {
    using T = Lane<V>;
    const T e = T(e_at_t), pi = std::numbers::pi_v<T>, pi_a = T(std::numbers::pi * amplitude);
    const V f = (e * x[0] + (1 - 2 * e)) * x[0];
    const V slope = 2 * e * x[0] + (1 - 2 * e);
    V sf, cf, sy, cy;
    trig(pi * f, sf, cf);
    trig(pi * x[1], sy, cy);
    u[0] = -pi_a * (sf * cy);
    u[1] = pi_a * (cf * sy) * slope;
  }
};

}  // namespace substep::fields
