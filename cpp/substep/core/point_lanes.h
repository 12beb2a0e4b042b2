// Rows of points in lanes: as many points as V has lanes, gathered by index with aligned loads of
// 128 bits and unpacking, which is faster than gathers.
#pragma once

#include <bit>
#include <cstdint>
#include <utility>

#include "substep/core/lanes.h"
#include "substep/core/point.h"

namespace substep {

template <class V>
struct PointLanes {
  V x, y, z, w;
};

#if defined(__x86_64__)
namespace detail {

// Pieces of 128 bits from address(0), address(1), ... one behind the other.
template <class V, class Address>
SUBSTEP_INLINE V join_quarters(const Address& address) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64) {
    const __m512 low = _mm512_insertf32x4(_mm512_castps128_ps512(_mm_load_ps(address(0))),
                                          _mm_load_ps(address(1)), 1);
    return reinterpret_cast<V>(_mm512_insertf32x4(
        _mm512_insertf32x4(low, _mm_load_ps(address(2)), 2), _mm_load_ps(address(3)), 3));
  }
#endif
#if defined(__AVX__)
  if constexpr (sizeof(V) == 32) {
    return reinterpret_cast<V>(_mm256_insertf128_ps(_mm256_castps128_ps256(_mm_load_ps(address(0))),
                                                    _mm_load_ps(address(1)), 1));
  }
#endif
  if constexpr (sizeof(V) == 16) {
    return reinterpret_cast<V>(_mm_load_ps(address(0)));
  }
}

// Of each 128 bits: numbers `a` and `b` of the first vector, then `c` and `d` of the second.
template <int a, int b, int c, int d, class V>
SUBSTEP_INLINE V pick(const V& first, const V& second) {
  if constexpr (sizeof(V) == 64) {
    return __builtin_shufflevector(first, second, a, b, 16 + c, 16 + d, a + 4, b + 4, 20 + c,
                                   20 + d, a + 8, b + 8, 24 + c, 24 + d, a + 12, b + 12, 28 + c,
                                   28 + d);
  } else if constexpr (sizeof(V) == 32) {
    return __builtin_shufflevector(first, second, a, b, 8 + c, 8 + d, a + 4, b + 4, 12 + c, 12 + d);
  } else {
    return __builtin_shufflevector(first, second, a, b, 4 + c, 4 + d);
  }
}

// Of each 128 bits: number `k` of the first vector, then that of the second (float64).
template <int k, class V>
SUBSTEP_INLINE V pick_pair(const V& first, const V& second) {
  if constexpr (sizeof(V) == 64) {
    return __builtin_shufflevector(first, second, k, 8 + k, k + 2, 10 + k, k + 4, 12 + k, k + 6,
                                   14 + k);
  } else if constexpr (sizeof(V) == 32) {
    return __builtin_shufflevector(first, second, k, 4 + k, k + 2, 6 + k);
  } else {
    return __builtin_shufflevector(first, second, k, 2 + k);
  }
}

}  // namespace detail
#endif

// The rows *at(0), *at(1), ... by lane.
template <class V, class At>
SUBSTEP_INLINE PointLanes<V> load_rows(const At& at) {
  using Real = Lane<V>;
#if defined(__x86_64__)
  if constexpr (sizeof(Real) == 4) {
    const auto row = [&](int k) __attribute__((always_inline)) {
      return detail::join_quarters<V>([&](int part) { return &at(k + 4 * part)->x; });
    };
    const V r0 = row(0), r1 = row(1), r2 = row(2), r3 = row(3);
    const V xy01 = detail::pick<0, 1, 0, 1>(r0, r1), xy23 = detail::pick<0, 1, 0, 1>(r2, r3);
    const V zw01 = detail::pick<2, 3, 2, 3>(r0, r1), zw23 = detail::pick<2, 3, 2, 3>(r2, r3);
    return {detail::pick<0, 2, 0, 2>(xy01, xy23), detail::pick<1, 3, 1, 3>(xy01, xy23),
            detail::pick<0, 2, 0, 2>(zw01, zw23), detail::pick<1, 3, 1, 3>(zw01, zw23)};
  } else {
    const auto half = [&](int k, int offset) __attribute__((always_inline)) {
      return detail::join_quarters<V>([&](int part) {  // xy (0) or zw (2) of every second row
        return reinterpret_cast<const float*>(&at(k + 2 * part)->x + offset);
      });
    };
    const V xy0 = half(0, 0), xy1 = half(1, 0), zw0 = half(0, 2), zw1 = half(1, 2);
    return {detail::pick_pair<0>(xy0, xy1), detail::pick_pair<1>(xy0, xy1),
            detail::pick_pair<0>(zw0, zw1), detail::pick_pair<1>(zw0, zw1)};
  }
#else
  PointLanes<V> lanes;
  for (unsigned k = 0; k < sizeof(V) / sizeof(Real); ++k) {
    const Point<Real>& p = *at(static_cast<int>(k));
    lanes.x[k] = p.x, lanes.y[k] = p.y, lanes.z[k] = p.z, lanes.w[k] = p.w;
  }
  return lanes;
#endif
}

// points[index[0]], points[index[1]], ... by lane.
template <class V>
SUBSTEP_INLINE PointLanes<V> load_points(const Point<Lane<V>>* points, const std::int32_t* index) {
  return load_rows<V>([&](int lane) { return points + index[lane]; });
}

// numbers[index[0]], numbers[index[1]], ... by lane.
template <class V>
SUBSTEP_INLINE V gather(const Lane<V>* numbers, const std::int32_t* index) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && sizeof(Lane<V>) == 4) {
    return reinterpret_cast<V>(_mm512_i32gather_ps(_mm512_loadu_si512(index), numbers, 4));
  }
#endif
#if defined(__AVX2__)
  if constexpr (sizeof(V) == 32 && sizeof(Lane<V>) == 4) {
    const auto* at = reinterpret_cast<const __m256i*>(index);
    return reinterpret_cast<V>(_mm256_i32gather_ps(numbers, _mm256_loadu_si256(at), 4));
  }
#endif
  V lanes;
  for (unsigned k = 0; k < sizeof(V) / sizeof(Lane<V>); ++k) lanes[k] = numbers[index[k]];
  return lanes;
}

// The first half of the lanes plus the second.
template <class V>
SUBSTEP_INLINE Vector<Lane<V>, sizeof(V) / 2> fold(const V& a) {
  constexpr int kHalf = sizeof(V) / sizeof(Lane<V>) / 2;
  return [&]<int... k>(std::integer_sequence<int, k...>) __attribute__((always_inline)) {
    return __builtin_shufflevector(a, a, k...) + __builtin_shufflevector(a, a, kHalf + k...);
  }(std::make_integer_sequence<int, kHalf>());
}

// The sum over the lanes, in pairs, so always in the same order.
template <class V>
SUBSTEP_INLINE Lane<V> sum_lanes(const V& a) {
  constexpr int kLanes = sizeof(V) / sizeof(Lane<V>);
#if defined(__x86_64__)
  if constexpr (sizeof(V) > 16) {
    return sum_lanes(fold(a));
  }
#endif
  Lane<V> part[kLanes];
  std::memcpy(part, &a, sizeof a);
  for (int width = kLanes / 2; width > 0; width /= 2) {
    for (int k = 0; k < width; ++k) part[k] += part[k + width];
  }
  return part[0];
}

// The four numbers of a point as lanes.
template <class Real>
using Quad = Vector<Real, 4 * sizeof(Real)>;

template <class Real>
SUBSTEP_INLINE Quad<Real> load_quad(const Point<Real>& point) {
  return std::bit_cast<Quad<Real>>(point);
}
template <class Real>
SUBSTEP_INLINE void store_quad(Point<Real>& point, const Quad<Real>& quad) {
  point = std::bit_cast<Point<Real>>(quad);
}

// The sums over the lanes of x, y, z and w: cheaper than four of sum_lanes.
template <class V>
SUBSTEP_INLINE Quad<Lane<V>> sum_points(const PointLanes<V>& p) {
  using Real = Lane<V>;
  constexpr int kLanes = sizeof(V) / sizeof(Real);
  if constexpr (kLanes > 4) {
    return sum_points<Vector<Real, sizeof(V) / 2>>({fold(p.x), fold(p.y), fold(p.z), fold(p.w)});
  } else if constexpr (kLanes == 4) {
    const V xy = __builtin_shufflevector(p.x, p.y, 0, 4, 1, 5) +
                 __builtin_shufflevector(p.x, p.y, 2, 6, 3, 7);
    const V zw = __builtin_shufflevector(p.z, p.w, 0, 4, 1, 5) +
                 __builtin_shufflevector(p.z, p.w, 2, 6, 3, 7);
    return __builtin_shufflevector(xy, zw, 0, 1, 4, 5) +
           __builtin_shufflevector(xy, zw, 2, 3, 6, 7);
  } else {
    static_assert(kLanes == 2);
    return Quad<Real>{p.x[0] + p.x[1], p.y[0] + p.y[1], p.z[0] + p.z[1], p.w[0] + p.w[1]};
  }
}

// 1 / sqrt(a) for a > 0: float32 by the machine's estimate and a step of Newton's method (relative
// error below 4e-7), float64 by square root and division.
template <class V>
SUBSTEP_INLINE V inverse_sqrt(const V& a) {
  if constexpr (sizeof(Lane<V>) == 4) {
    V y;
#if defined(__AVX512F__)
    if constexpr (sizeof(V) == 64) {
      y = reinterpret_cast<V>(_mm512_rsqrt14_ps(reinterpret_cast<__m512>(a)));
      return y * fma<V>(-0.5f * a * y, y, splat<V>(1.5f));
    }
#endif
#if defined(__AVX__)
    if constexpr (sizeof(V) == 32) {
      y = reinterpret_cast<V>(_mm256_rsqrt_ps(reinterpret_cast<__m256>(a)));
      return y * fma<V>(-0.5f * a * y, y, splat<V>(1.5f));
    }
#endif
#if defined(__x86_64__)
    if constexpr (sizeof(V) == 16) {
      y = reinterpret_cast<V>(_mm_rsqrt_ps(reinterpret_cast<__m128>(a)));
      return y * fma<V>(-0.5f * a * y, y, splat<V>(1.5f));
    }
#endif
  }
  V root;
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && sizeof(Lane<V>) == 8) {
    root = reinterpret_cast<V>(_mm512_sqrt_pd(reinterpret_cast<__m512d>(a)));
    return 1 / root;
  }
#endif
#if defined(__AVX__)
  if constexpr (sizeof(V) == 32 && sizeof(Lane<V>) == 8) {
    root = reinterpret_cast<V>(_mm256_sqrt_pd(reinterpret_cast<__m256d>(a)));
    return 1 / root;
  }
#endif
  for (unsigned k = 0; k < sizeof(V) / sizeof(a[0]); ++k) root[k] = std::sqrt(a[k]);
  return 1 / root;
}

}  // namespace substep
