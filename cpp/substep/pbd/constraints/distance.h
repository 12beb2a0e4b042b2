// Keeps two particles at their distance: C = |x_0 - x_1| - r.
//
//   dC/dx_0 = n = (x_0 - x_1) / |x_0 - x_1|,   dC/dx_1 = -n
//
// Mueller et al., "Position based dynamics", 2007, section 3.3. Coincident points have no n.
#pragma once

#include <array>
#include <limits>

#include "substep/core/point_lanes.h"
#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct Distance {
  static constexpr const char* kName = "distance";
  static constexpr int kPoints = 2;
  static constexpr int kParameters = 1;  // r
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 2>& x, const std::array<V, 1>& p,
                                      V& c, std::array<Lanes3<V>, 2>& gradient) {
    const Lanes3<V> d = x[0] - x[1];
    const V square = dot(d, d);
    const V inverse = square > std::numeric_limits<Lane<V>>::min() ? inverse_sqrt(square) : V{};
    c = fma(square, inverse, -p[0]);
    gradient[0] = inverse * d;
    gradient[1] = -gradient[0];
  }
};

}  // namespace substep::pbd
