// What a built-in constraint is: formulas over lanes, nothing else. A struct with
//
//   static constexpr int kPoints;       how many particles one constraint joins
//   static constexpr int kParameters;   numbers of its own (rest length, rest angle, ...)
//   static constexpr bool kInequality;  C >= 0 is satisfied: acts only while C < 0
//   template <class V> static void evaluate(
//       const std::array<Lanes3<V>, kPoints>& x, const std::array<V, kParameters>& p,
//       V& c, std::array<Lanes3<V>, kPoints>& gradient);
//
// evaluates C and its gradients for as many constraints as V has lanes. Where a gradient does not
// exist (coincident points, a triangle without area) it returns zeros, and the solver skips and
// counts the constraint. project.h makes of it a Gauss-Seidel or Jacobi sweep over coloured groups;
// the shared tests check the gradient by finite differences, and momentum and invariance by it.
#pragma once

#include <array>

#include "substep/core/lanes.h"

namespace substep::pbd {

// A 3-vector in each lane.
template <class V>
struct Lanes3 {
  V x, y, z;
};

}  // namespace substep::pbd
