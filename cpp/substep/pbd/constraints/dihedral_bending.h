// Bending of two triangles about their common edge, by their angle.
//
// Points: the edge (a, b), then the other corners c and d: triangles (a, b, c) and (b, a, d), as in
// TriangleMesh.hinges. With e = b - a and the normals n = e x (c - a), m = (d - a) x e:
//
//   theta = atan2(e/|e| . (m x n), n . m),   C = theta - theta_0, brought into [-pi, pi]
//
// theta is 0 when flat and positive when c and d rise to the side of the normals. Mueller et al.,
// "Position based dynamics", 2007, eq. 4, take the arc cosine of n . m instead, whose gradient does
// not exist when flat; that of the signed angle does, and has the short form of Bridson, Marino,
// Fedkiw, "Simulation of clothing with folds and wrinkles", SCA 2003, section 4. With
// s = (c - a) . e / |e|^2 and t = (d - a) . e / |e|^2, the feet of the heights of c and d:
//
//   dC/dc = |e| n / |n|^2                          dC/da = -(1 - s) dC/dc - (1 - t) dC/dd
//   dC/dd = |e| m / |m|^2                          dC/db =      -s  dC/dc -      t  dC/dd
//
// Without an edge, or with a triangle without area, there is no angle: the gradient is 0, C = pi.
#pragma once

#include <array>
#include <numbers>

#include "substep/core/atan2.h"
#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct DihedralBending {
  static constexpr const char* kName = "dihedral_bending";
  static constexpr int kPoints = 4;
  static constexpr int kParameters = 1;  // theta_0
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE V angle(const std::array<Lanes3<V>, 4>& x) {
    const Lanes3<V> e = x[1] - x[0], n = cross(e, x[2] - x[0]), m = cross(x[3] - x[0], e);
    return atan2<V>(dot(e, cross(m, n)), square_root(dot(e, e)) * dot(n, m));
  }

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 4>& x, const std::array<V, 1>& p,
                                      V& c, std::array<Lanes3<V>, 4>& gradient) {
    using T = Lane<V>;
    constexpr T kPi = std::numbers::pi_v<T>;
    const V zero{}, one = zero + 1;
    const Lanes3<V> e = x[1] - x[0], f = x[2] - x[0], g = x[3] - x[0];
    const Lanes3<V> n = cross(e, f), m = cross(g, e);
    const V ee = dot(e, e), nn = dot(n, n), mm = dot(m, m), length = square_root(ee);
    const auto regular =
        (nn > kParallel<V> * (ee * dot(f, f))) & (mm > kParallel<V> * (ee * dot(g, g)));

    const V theta = atan2<V>(dot(e, cross(m, n)), length * dot(n, m)) - p[0];
    c = theta > kPi ? theta - 2 * kPi : theta < -kPi ? theta + 2 * kPi : theta;
    c = regular ? c : zero + kPi;

    const V per_edge = one / (regular ? ee : one);
    const V s = dot(f, e) * per_edge, t = dot(g, e) * per_edge;
    gradient[2] = (regular ? length / (regular ? nn : one) : zero) * n;
    gradient[3] = (regular ? length / (regular ? mm : one) : zero) * m;
    gradient[0] = (s - one) * gradient[2] + (t - one) * gradient[3];
    gradient[1] = (zero - s) * gradient[2] - t * gradient[3];
  }
};

}  // namespace substep::pbd
