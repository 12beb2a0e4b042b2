// The way back from lanes to rows of points: the inverse of load_rows (point_lanes.h).
#pragma once

#include <cstdint>

#include "substep/core/point_lanes.h"

namespace substep {

#if defined(__x86_64__)
namespace detail {

// Pieces of 128 bits to address(0), address(1), ...
template <class V, class Address>
SUBSTEP_INLINE void split_quarters(const V& v, const Address& address) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64) {
    const __m512 a = reinterpret_cast<__m512>(v);
    _mm_store_ps(address(0), _mm512_castps512_ps128(a));
    _mm_store_ps(address(1), _mm512_extractf32x4_ps(a, 1));
    _mm_store_ps(address(2), _mm512_extractf32x4_ps(a, 2));
    _mm_store_ps(address(3), _mm512_extractf32x4_ps(a, 3));
    return;
  }
#endif
#if defined(__AVX__)
  if constexpr (sizeof(V) == 32) {
    const __m256 a = reinterpret_cast<__m256>(v);
    _mm_store_ps(address(0), _mm256_castps256_ps128(a));
    _mm_store_ps(address(1), _mm256_extractf128_ps(a, 1));
    return;
  }
#endif
  if constexpr (sizeof(V) == 16) _mm_store_ps(address(0), reinterpret_cast<__m128>(v));
}

}  // namespace detail
#endif

// at(lane) is the address of the row of each lane.
template <class V, class At>
SUBSTEP_INLINE void store_rows(const PointLanes<V>& p, const At& at) {
  using Real = Lane<V>;
#if defined(__x86_64__)
  using detail::pick;
  using detail::pick_pair;
  if constexpr (sizeof(Real) == 4) {
    const V xy01 = pick<0, 1, 0, 1>(p.x, p.y), xy23 = pick<2, 3, 2, 3>(p.x, p.y);
    const V zw01 = pick<0, 1, 0, 1>(p.z, p.w), zw23 = pick<2, 3, 2, 3>(p.z, p.w);
    const auto row = [&](const V& v, int k) __attribute__((always_inline)) {
      detail::split_quarters(v, [&](int part) { return &at(k + 4 * part)->x; });
    };
    row(pick<0, 2, 0, 2>(xy01, zw01), 0);
    row(pick<1, 3, 1, 3>(xy01, zw01), 1);
    row(pick<0, 2, 0, 2>(xy23, zw23), 2);
    row(pick<1, 3, 1, 3>(xy23, zw23), 3);
  } else {
    const auto half = [&](const V& v, int k, int offset) __attribute__((always_inline)) {
      detail::split_quarters(
          v, [&](int part) { return reinterpret_cast<float*>(&at(k + 2 * part)->x + offset); });
    };
    half(pick_pair<0>(p.x, p.y), 0, 0);
    half(pick_pair<1>(p.x, p.y), 1, 0);
    half(pick_pair<0>(p.z, p.w), 0, 2);
    half(pick_pair<1>(p.z, p.w), 1, 2);
  }
#else
  for (unsigned k = 0; k < sizeof(V) / sizeof(Real); ++k) {
    *at(static_cast<int>(k)) = {p.x[k], p.y[k], p.z[k], p.w[k]};
  }
#endif
}

// To points[index[0]], points[index[1]], ... by lane: different ones.
template <class V>
SUBSTEP_INLINE void store_points(const PointLanes<V>& p, Point<Lane<V>>* points,
                                 const std::int32_t* index) {
  store_rows(p, [&](int lane) { return points + index[lane]; });
}

}  // namespace substep
