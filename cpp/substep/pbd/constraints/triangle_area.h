// The area of a triangle, with n = (b - a) x (c - a):
//
//   C = |n| / 2 - A_0,   dC/da = 1/2 n/|n| x (c - b),   and so on around the triangle
//
// (Bender et al., "Position-based simulation methods in computer graphics", 2015, section 5). A
// triangle without area has no normal: gradient 0.
#pragma once

#include <array>

#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct TriangleArea {
  static constexpr const char* kName = "triangle_area";
  static constexpr int kPoints = 3;
  static constexpr int kParameters = 1;  // A_0
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 3>& x, const std::array<V, 1>& p,
                                      V& c, std::array<Lanes3<V>, 3>& gradient) {
    const Lanes3<V> u = x[1] - x[0], v = x[2] - x[0], n = cross(u, v);
    const V square = dot(n, n), length = square_root(square);
    c = length * Lane<V>(0.5) - p[0];
    const auto regular = square > kParallel<V> * (dot(u, u) * dot(v, v));
    const V half = (V{} + Lane<V>(0.5)) / (regular ? length : V{} + 1);
    const Lanes3<V> normal = (regular ? half : V{}) * n;
    gradient[1] = cross(v, normal);
    gradient[2] = cross(normal, u);
    gradient[0] = -(gradient[1] + gradient[2]);
  }
};

}  // namespace substep::pbd
