// The volume of a tetrahedron (a, b, c, d), negative when inverted, so that it is turned back:
//
//   C = ((b - a) x (c - a)) . (d - a) / 6 - V_0,   dC/dd = ((b - a) x (c - a)) / 6, ...
//
// (Mueller et al., "Position based dynamics", 2007, section 4.4, which sums them over a closed
// surface; Bender et al., 2015, section 5). The gradient is 0 only for points on a line.
#pragma once

#include <array>

#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct TetrahedronVolume {
  static constexpr const char* kName = "tetrahedron_volume";
  static constexpr int kPoints = 4;
  static constexpr int kParameters = 1;  // V_0
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 4>& x, const std::array<V, 1>& p,
                                      V& c, std::array<Lanes3<V>, 4>& gradient) {
    const V sixth = V{} + Lane<V>(1.0 / 6.0);
    const Lanes3<V> u = x[1] - x[0], v = x[2] - x[0], w = sixth * (x[3] - x[0]);
    gradient[1] = cross(v, w);
    gradient[2] = cross(w, u);
    gradient[3] = sixth * cross(u, v);
    gradient[0] = -(gradient[1] + gradient[2] + gradient[3]);
    c = dot(gradient[1], u) - p[0];
  }
};

}  // namespace substep::pbd
