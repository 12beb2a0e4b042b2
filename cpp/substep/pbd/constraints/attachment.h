// A point held at a target t, which may move from step to step; soft by its compliance:
//
//   C = |x - t|,   dC/dx = (x - t) / |x - t|
//
// so that C^2 / (2 alpha) is the energy of a spring of stiffness 1 / alpha and no length. At the
// target itself C = 0 and the gradient is 0.
#pragma once

#include <array>

#include "substep/pbd/constraints/lanes3.h"

namespace substep::pbd {

struct Attachment {
  static constexpr const char* kName = "attachment";
  static constexpr int kPoints = 1;
  static constexpr int kParameters = 3;  // t
  static constexpr bool kInequality = false;

  template <class V>
  static SUBSTEP_INLINE void evaluate(const std::array<Lanes3<V>, 1>& x, const std::array<V, 3>& p,
                                      V& c, std::array<Lanes3<V>, 1>& gradient) {
    const Lanes3<V> d = x[0] - Lanes3<V>{p[0], p[1], p[2]};
    c = square_root(dot(d, d));
    gradient[0] = quotient(V{} + 1, c, V{}) * d;
  }
};

}  // namespace substep::pbd
