// The exponential function, without branches, for vectors of lanes. Error at most 2 units in the
// last place; beyond +-87 (float) or +-708 (double) it is that of the bound, so that the result is
// always a normal number; NaN stays NaN (tests/cpp/mpm/materials.cpp).
//
// exp(x) = 2^n exp(r), n the nearest integer to x / log 2, |r| <= log(2) / 2, log 2 being split so
// that n times its first part is exact; exp(r) by the approximations of Cephes expf.c (float, a
// polynomial) and exp.c (double, 1 + 2 r P(r^2) / (Q(r^2) - r P(r^2))).
#pragma once

#include <numbers>

#include "substep/core/lanes.h"

namespace substep {

template <class V>
SUBSTEP_INLINE V exp(const V& argument) {
  using T = Lane<V>;
  using I = std::remove_cvref_t<decltype(argument < argument)>;
  constexpr bool kDouble = sizeof(T) == 8;
  constexpr int kMantissa = kDouble ? 52 : 23, kBias = kDouble ? 1023 : 127;
  constexpr T kBound = kDouble ? T(708) : T(87);
  // 1.5 2^kMantissa: added to a small number, its lowest bits are the nearest integer.
  constexpr T kShift = T(1.5) * T(std::int64_t{1} << kMantissa);
  V x = argument > kBound ? splat<V>(kBound) : argument;
  x = x < -kBound ? splat<V>(-kBound) : x;
  const V shifted = fma(std::numbers::log2e_v<T>, x, splat<V>(kShift));
  const V n = shifted - kShift;
  const I exponent = reinterpret_cast<I>(shifted) - reinterpret_cast<I>(splat<V>(kShift));
  V y;
  if constexpr (kDouble) {
    V r = fma(T(-6.93145751953125e-1), n, x);
    r = fma(T(-1.42860682030941723212e-6), n, r);
    const V z = r * r;
    V p = fma(T(1.26177193074810590878e-4), z, splat<V>(T(3.02994407707441961300e-2)));
    p = r * fma(z, p, T(9.99999999999999999910e-1));
    V q = fma(T(3.00198505138664455042e-6), z, splat<V>(T(2.52448340349684104192e-3)));
    q = fma(z, q, T(2.27265548208155028766e-1));
    q = fma(z, q, T(2.00000000000000000009e0));
    y = fma(T(2), p / (q - p), splat<V>(T(1)));
  } else {
    V r = fma(T(-0.693359375), n, x);
    r = fma(T(2.12194440e-4), n, r);
    V p = fma(T(1.9875691500e-4), r, splat<V>(T(1.3981999507e-3)));
    p = fma(r, p, T(8.3334519073e-3));
    p = fma(r, p, T(4.1665795894e-2));
    p = fma(r, p, T(1.6666665459e-1));
    p = fma(r, p, T(5.0000001201e-1));
    y = fma<V>(r * r, p, r) + T(1);
  }
  return y * reinterpret_cast<V>((exponent + kBias) << kMantissa);
}

}  // namespace substep
