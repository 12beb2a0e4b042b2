// The angle of a vector, without branches, for vectors of lanes: atan2(y, x) in [-pi, pi], 0 where
// both are 0, with the sign of y. Error at most 3 units in the last place
// (tests/cpp/pbd/constraints.cpp).
//
// With 0 <= t = low / high <= 1 of |x| and |y|, atan t = pi/4 + atan((t - 1) / (t + 1)) where t is
// above tan(pi/8); on the rest the polynomials of Cephes atanf.c (float) and atan.c (double).
#pragma once

#include <numbers>

#include "substep/core/lanes.h"

namespace substep {

template <class V>
SUBSTEP_INLINE V atan2(const V& y, const V& x) {
  using T = Lane<V>;
  const V zero{}, one = zero + 1;
  const V a = y < zero ? -y : y, b = x < zero ? -x : x;
  const V low = a < b ? a : b, high = a < b ? b : a;
  const auto large = low > T(0.41421356237309504880) * high;  // tan(pi/8)
  const V down = large ? low + high : high;
  const V t = (large ? low - high : low) / (down > zero ? down : one);
  const V z = t * t;
  V p;
  if constexpr (sizeof(T) == 8) {
    p = fma(z, splat<V>(T(-8.750608600031904122785e-1)), T(-1.615753718733365076637e1));
    p = fma(z, p, T(-7.500855792314704667340e1));
    p = fma(z, p, T(-1.228866684490136173410e2));
    p = fma(z, p, T(-6.485021904942025371773e1));
    V q = fma(z, one, T(2.485846490142306297962e1));
    q = fma(z, q, T(1.650270098316988542046e2));
    q = fma(z, q, T(4.328810604912902668951e2));
    q = fma(z, q, T(4.853903996359136964868e2));
    q = fma(z, q, T(1.945506571482613964425e2));
    p = p / q;
  } else {
    p = fma(z, splat<V>(T(8.05374449538e-2)), T(-1.38776856032e-1));
    p = fma(z, p, T(1.99777106478e-1));
    p = fma(z, p, T(-3.33329491539e-1));
  }
  V angle = fma(t * z, p, t);
  angle = large ? angle + std::numbers::pi_v<T> / 4 : angle;
  angle = a > b ? std::numbers::pi_v<T> / 2 - angle : angle;
  angle = x < zero ? std::numbers::pi_v<T> - angle : angle;
  return y < zero ? -angle : angle;
}

}  // namespace substep
