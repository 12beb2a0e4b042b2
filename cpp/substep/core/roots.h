// Square roots of vectors of lanes, and their inverses by the machine's estimate.
#pragma once

#include "substep/core/lanes.h"

namespace substep {

// Correctly rounded.
template <class V>
SUBSTEP_INLINE V sqrt(const V& a) {
  constexpr bool kDouble = sizeof(Lane<V>) == 8;
#ifdef __AVX512F__
  if constexpr (sizeof(V) == 64 && kDouble) {
    return reinterpret_cast<V>(_mm512_sqrt_pd(reinterpret_cast<__m512d>(a)));
  } else if constexpr (sizeof(V) == 64) {
    return reinterpret_cast<V>(_mm512_sqrt_ps(reinterpret_cast<__m512>(a)));
  }
#endif
#ifdef __AVX__
  if constexpr (sizeof(V) == 32 && kDouble) {
    return reinterpret_cast<V>(_mm256_sqrt_pd(reinterpret_cast<__m256d>(a)));
  } else if constexpr (sizeof(V) == 32) {
    return reinterpret_cast<V>(_mm256_sqrt_ps(reinterpret_cast<__m256>(a)));
  }
#endif
#ifdef __x86_64__
  if constexpr (sizeof(V) == 16 && kDouble) {
    return reinterpret_cast<V>(_mm_sqrt_pd(reinterpret_cast<__m128d>(a)));
  } else if constexpr (sizeof(V) == 16) {
    return reinterpret_cast<V>(_mm_sqrt_ps(reinterpret_cast<__m128>(a)));
  }
#endif
  V root;
  for (unsigned lane = 0; lane < sizeof(V) / sizeof(a[0]); ++lane) {
    root[lane] = std::sqrt(a[lane]);
  }
  return root;
}

// 1 / sqrt(a) for normal a > 0, with a relative error below 4e-4.
template <class V>
SUBSTEP_INLINE V inverse_sqrt_estimate(const V& a) {
  constexpr bool kDouble = sizeof(Lane<V>) == 8;
#ifdef __AVX512F__
  if constexpr (sizeof(V) == 64 && kDouble) {
    return reinterpret_cast<V>(_mm512_rsqrt14_pd(reinterpret_cast<__m512d>(a)));
  } else if constexpr (sizeof(V) == 64) {
    return reinterpret_cast<V>(_mm512_rsqrt14_ps(reinterpret_cast<__m512>(a)));
  }
#endif
#ifdef __AVX__
  if constexpr (sizeof(V) == 32 && !kDouble) {
    return reinterpret_cast<V>(_mm256_rsqrt_ps(reinterpret_cast<__m256>(a)));
  }
#endif
#ifdef __x86_64__
  if constexpr (sizeof(V) == 16 && !kDouble) {
    return reinterpret_cast<V>(_mm_rsqrt_ps(reinterpret_cast<__m128>(a)));
  }
#endif
  static_cast<void>(kDouble);
  return 1 / sqrt<V>(a);
}

// 1 / sqrt(a) for normal a > 0 whose square roots are too, to rounding. With e = 1 - a y^2,
// 1 / sqrt(a) = y (1 - e)^(-1/2) = y (1 + e/2 + 3/8 e^2 + ...): the third order is for estimates of
// 12 bits, and repeated in double precision.
template <class V>
SUBSTEP_INLINE V inverse_root(const V& a) {
  constexpr bool kDouble = sizeof(Lane<V>) == 8;
  if constexpr (kDouble && sizeof(V) != 64) return 1 / sqrt<V>(a);
  V y = inverse_sqrt_estimate<V>(a);
  if constexpr (sizeof(V) == 64) {  // 14 bits: second order
    y = fma<V>(y * fma<V>(-a * y, y, splat<V>(1)), splat<V>(Lane<V>(0.5)), y);
    if constexpr (!kDouble) return y;
  }
  const V e = fma<V>(-a * y, y, splat<V>(1));
  return fma<V>(y * e, fma<V>(Lane<V>(0.375), e, splat<V>(Lane<V>(0.5))), y);
}

}  // namespace substep
