// A tether (long-range attachment): two points, commonly a pinned one and one far along the cloth,
// are never further apart than the cloth is long between them.
//
//   C = l - |x_1 - x_0| >= 0,   dC/dx_0 = (x_1 - x_0) / |x_1 - x_0| = -dC/dx_1
//
// Kim, Chentanez, Mueller, "Long range attachments", SCA 2012, section 3. One sweep carries the
// position of a pin through the whole cloth; where the tether is slack it does nothing.
#pragma once

#include <array>

#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct Tether {
  static constexpr const char* kName = "tether";
  static constexpr int kPoints = 2;
  static constexpr int kParameters = 1;  // l
  static constexpr bool kInequality = true;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 2>& x, const std::array<V, 1>& p,
                                      V& c, std::array<Lanes3<V>, 2>& gradient) {
    const Lanes3<V> d = x[1] - x[0];
    const V length = square_root(dot(d, d));
    c = p[0] - length;
    gradient[0] = quotient(V{} + 1, length, V{}) * d;
    gradient[1] = -gradient[0];
  }
};

}  // namespace substep::pbd
