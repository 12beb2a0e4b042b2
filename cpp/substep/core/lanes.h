// Vectors of lanes (GCC and Clang vector extensions): arithmetic is element by element, so the bits
// of one lane do not depend on its neighbours, nor on how many there are.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <type_traits>
#ifdef __x86_64__
#include <immintrin.h>
#endif

#ifdef SUBSTEP_ONCE
#error "compiled once for all levels (CMakeLists.txt), and so must not see lanes"
#endif

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // all functions on vectors are inlined
#endif
#ifdef __SANITIZE_ADDRESS__  // with its checks, a copy in each kernel takes minutes to compile
#define SUBSTEP_INLINE inline
#else
#define SUBSTEP_INLINE inline __attribute__((always_inline))
#endif

namespace substep {

#if defined(__AVX512F__)
inline constexpr int kVectorBytes = 64;
#elif defined(__AVX__)
inline constexpr int kVectorBytes = 32;
#else
inline constexpr int kVectorBytes = 16;
#endif

// Integer of the width of T, for the bits and masks of its lanes.
template <class T>
using IntOf = std::conditional_t<sizeof(T) == 8, std::int64_t, std::int32_t>;

template <class T, int kBytes>
struct VectorOf {
  typedef T type __attribute__((vector_size(kBytes)));
};
template <class T, int kBytes = kVectorBytes>
using Vector = typename VectorOf<T, kBytes>::type;

template <class V>
using Lane = std::remove_cvref_t<decltype(V{}[0])>;

// The numbers at an address that need not be aligned to the vector.
template <class V>
SUBSTEP_INLINE V load(const Lane<V>* from) {
  V v;
  std::memcpy(&v, from, sizeof v);
  return v;
}

// The same number in all lanes. (a - 0 is a, also for -0, so nothing is computed.)
template <class V>
SUBSTEP_INLINE V splat(Lane<V> a) {
  return a - V{};
}

// a * b + c, rounded once where the instruction level has FMA (so bits differ between levels).
template <class V>
SUBSTEP_INLINE V fma(const V& a, const V& b, const V& c) {
  constexpr bool kDouble = std::is_same_v<Lane<V>, double>;
#ifdef __AVX512F__
  if constexpr (sizeof(V) == 64) {
    if constexpr (kDouble) {
      return reinterpret_cast<V>(_mm512_fmadd_pd(reinterpret_cast<__m512d>(a),
                                                 reinterpret_cast<__m512d>(b),
                                                 reinterpret_cast<__m512d>(c)));
    } else {
      return reinterpret_cast<V>(_mm512_fmadd_ps(
          reinterpret_cast<__m512>(a), reinterpret_cast<__m512>(b), reinterpret_cast<__m512>(c)));
    }
  }
#endif
#ifdef __FMA__
  if constexpr (sizeof(V) == 32 && kDouble) {
    return reinterpret_cast<V>(_mm256_fmadd_pd(
        reinterpret_cast<__m256d>(a), reinterpret_cast<__m256d>(b), reinterpret_cast<__m256d>(c)));
  } else if constexpr (sizeof(V) == 32) {
    return reinterpret_cast<V>(_mm256_fmadd_ps(
        reinterpret_cast<__m256>(a), reinterpret_cast<__m256>(b), reinterpret_cast<__m256>(c)));
  } else if constexpr (sizeof(V) == 16 && !kDouble) {
    return reinterpret_cast<V>(_mm_fmadd_ps(
        reinterpret_cast<__m128>(a), reinterpret_cast<__m128>(b), reinterpret_cast<__m128>(c)));
  }
#endif
  static_cast<void>(kDouble);
  return a * b + c;
}
template <class V>
SUBSTEP_INLINE V fma(Lane<V> a, const V& b, const V& c) {
  return fma<V>(splat<V>(a), b, c);
}
template <class V>
SUBSTEP_INLINE V fma(const V& a, const V& b, Lane<V> c) {
  return fma<V>(a, b, splat<V>(c));
}

// Whether any lane of a comparison's result is set.
template <class Mask>
SUBSTEP_INLINE bool any(const Mask& mask) {
#ifdef __AVX512F__
  if constexpr (sizeof(Mask) == 64) {
    const __m512i m = reinterpret_cast<__m512i>(mask);
    return _mm512_test_epi64_mask(m, m) != 0;
  }
#endif
#ifdef __AVX__
  if constexpr (sizeof(Mask) == 32) {
    const __m256i m = reinterpret_cast<__m256i>(mask);
    return !_mm256_testz_si256(m, m);
  }
#endif
  bool found = false;
  for (unsigned lane = 0; lane < sizeof(Mask) / sizeof(mask[0]); ++lane) found |= mask[lane] != 0;
  return found;
}

// Whether low <= a <= high in all lanes; not where a is NaN.
template <class V>
SUBSTEP_INLINE bool all_within(const V& a, const V& low, const V& high) {
#ifdef __AVX__
  if constexpr (sizeof(V) == 32 && std::is_same_v<Lane<V>, double>) {
    const __m256d x = reinterpret_cast<__m256d>(a);
    const __m256d above = _mm256_cmp_pd(x, reinterpret_cast<__m256d>(low), _CMP_GE_OQ);
    const __m256d below = _mm256_cmp_pd(x, reinterpret_cast<__m256d>(high), _CMP_LE_OQ);
    return _mm256_movemask_pd(_mm256_and_pd(above, below)) == 15;
  }
#endif
  return !any(~((a >= low) & (a <= high)));
}

// The largest integer not above, lane by lane.
template <class V>
SUBSTEP_INLINE V floor(const V& a) {
#ifdef __AVX512F__
  if constexpr (sizeof(V) == 64 && std::is_same_v<Lane<V>, float>) {
    return reinterpret_cast<V>(_mm512_floor_ps(reinterpret_cast<__m512>(a)));
  } else if constexpr (sizeof(V) == 64 && std::is_same_v<Lane<V>, double>) {
    return reinterpret_cast<V>(_mm512_floor_pd(reinterpret_cast<__m512d>(a)));
  }
#endif
#ifdef __AVX__
  if constexpr (sizeof(V) == 32 && std::is_same_v<Lane<V>, double>) {
    return reinterpret_cast<V>(_mm256_floor_pd(reinterpret_cast<__m256d>(a)));
  } else if constexpr (sizeof(V) == 32 && std::is_same_v<Lane<V>, float>) {
    return reinterpret_cast<V>(_mm256_floor_ps(reinterpret_cast<__m256>(a)));
  }
#endif
#ifdef __SSE4_1__
  if constexpr (sizeof(V) == 16 && std::is_same_v<Lane<V>, float>) {
    return reinterpret_cast<V>(_mm_floor_ps(reinterpret_cast<__m128>(a)));
  }
#endif
  V result;
  for (unsigned lane = 0; lane < sizeof(V) / sizeof(a[0]); ++lane) {
    result[lane] = std::floor(a[lane]);
  }
  return result;
}

}  // namespace substep
