// The natural logarithm of normal numbers above 0, without branches, for vectors of lanes. Error at
// most 3 units in the last place, of the result or of 1/4 (tests/cpp/pbd/constraints.cpp).
//
// x = 2^e (1 + f) with 1 + f from 1/sqrt(2) to sqrt(2); log(1 + f) = f - f^2/2 + f^3 P(f) by the
// polynomials of Cephes logf.c (float) and log.c (double); log 2 is split so that e times its first
// part is exact.
#pragma once

#include "substep/core/lanes.h"

namespace substep {

template <class V>
SUBSTEP_INLINE V log(const V& x) {
  using T = Lane<V>;
  using I = std::remove_cvref_t<decltype(x < x)>;
  constexpr bool kDouble = sizeof(T) == 8;
  constexpr int kMantissa = kDouble ? 52 : 23, kBias = kDouble ? 1023 : 127;
  const I bits = reinterpret_cast<I>(x);
  const I low = (I{} + 1) << kMantissa;  // the lowest bit of the exponent
  I exponent = (bits >> kMantissa) - kBias;
  V m = reinterpret_cast<V>((bits & (low - 1)) | ((I{} + kBias) << kMantissa));  // 1 to 2
  const I halve = m > T(1.41421356237309504880);
  m = halve ? m * T(0.5) : m;
  exponent -= halve;  // a set lane is -1
  const V e = __builtin_convertvector(exponent, V), f = m - T(1), z = f * f;
  V p;
  if constexpr (kDouble) {
    p = fma(f, splat<V>(T(1.01875663804580931796e-4)), T(4.97494994976747001425e-1));
    p = fma(f, p, T(4.70579119878881725854e0));
    p = fma(f, p, T(1.44989225341610930846e1));
    p = fma(f, p, T(1.79368678507819816313e1));
    p = fma(f, p, T(7.70838733755885391666e0));
    V q = f + T(1.12873587189167450590e1);
    q = fma(f, q, T(4.52279145837532221105e1));
    q = fma(f, q, T(8.29875266912776603211e1));
    q = fma(f, q, T(7.11544750618563894466e1));
    q = fma(f, q, T(2.31251620126765340583e1));
    p = p / q;
  } else {
    p = fma(f, splat<V>(T(7.0376836292e-2)), T(-1.1514610310e-1));
    p = fma(f, p, T(1.1676998740e-1));
    p = fma(f, p, T(-1.2420140846e-1));
    p = fma(f, p, T(1.4249322787e-1));
    p = fma(f, p, T(-1.6668057665e-1));
    p = fma(f, p, T(2.0000714765e-1));
    p = fma(f, p, T(-2.4999993993e-1));
    p = fma(f, p, T(3.3333331174e-1));
  }
  V y = f * z * p;
  y = fma(T(-2.121944400546905827679e-4), e, y);
  y = fma(T(-0.5), z, y);
  return fma(T(0.693359375), e, f + y);
}

}  // namespace substep
