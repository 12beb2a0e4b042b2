// Arithmetic of 3-vectors in lanes, as the formulas of constraints need it.
#pragma once

#include "substep/core/lanes.h"
#include "substep/core/matrix3.h"
#include "substep/pbd/constraints/constraint.h"

namespace substep::pbd {

template <class V>
SUBSTEP_INLINE Lanes3<V> operator+(const Lanes3<V>& a, const Lanes3<V>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class V>
SUBSTEP_INLINE Lanes3<V> operator-(const Lanes3<V>& a, const Lanes3<V>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class V>
SUBSTEP_INLINE Lanes3<V> operator-(const Lanes3<V>& a) {
  return {-a.x, -a.y, -a.z};
}
template <class V>
SUBSTEP_INLINE Lanes3<V> operator*(const V& s, const Lanes3<V>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <class V>
SUBSTEP_INLINE V dot(const Lanes3<V>& a, const Lanes3<V>& b) {
  return fma(a.x, b.x, fma(a.y, b.y, a.z * b.z));
}
// Without fma: exactly 0 for parallel edges whose products are.
template <class V>
SUBSTEP_INLINE Lanes3<V> cross(const Lanes3<V>& a, const Lanes3<V>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// numerator / denominator, and 0 where the denominator is not above `least`.
template <class V>
SUBSTEP_INLINE V quotient(const V& numerator, const V& denominator, const V& least) {
  const auto regular = denominator > least;
  return regular ? numerator / (regular ? denominator : V{} + 1) : V{};
}

// The square of the sine below which two edges count as parallel: rounding leaves about as much.
template <class V>
inline constexpr Lane<V> kParallel = sizeof(Lane<V>) == 8 ? Lane<V>(1e-28) : Lane<V>(1e-12);

}  // namespace substep::pbd
