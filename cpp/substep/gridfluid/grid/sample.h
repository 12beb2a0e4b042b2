// Trilinear interpolation in lanes: each lane its own place in a grid.
#pragma once

#include <array>
#include <cstdint>
#include <type_traits>

#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

template <class V>
using Indices = Vector<IntOf<Lane<V>>, static_cast<int>(sizeof(V))>;

// low = from[index], high = from[index + 1]. Loads of both and a transpose are faster than gathers.
template <class V>
SUBSTEP_INLINE void load_pairs(const Lane<V>* from, const Indices<V>& index, V& low, V& high) {
#if defined(__x86_64__)
  constexpr bool kFloat = sizeof(Lane<V>) == 4;
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64 && kFloat) {
    const auto pairs = [&](const Vector<std::int32_t, 32>& i) __attribute__((always_inline)) {
      return reinterpret_cast<V>(_mm512_mask_i32gather_pd(
          _mm512_setzero_pd(), 0xff, reinterpret_cast<__m256i>(i), from, sizeof(float)));
    };
    const V first = pairs(__builtin_shufflevector(index, index, 0, 1, 2, 3, 4, 5, 6, 7));
    const V second = pairs(__builtin_shufflevector(index, index, 8, 9, 10, 11, 12, 13, 14, 15));
    low = __builtin_shufflevector(first, second, 0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26,
                                  28, 30);
    high = __builtin_shufflevector(first, second, 1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27,
                                   29, 31);
    return;
  }
  if constexpr (sizeof(V) == 64 && !kFloat) {
    const __m512i i = reinterpret_cast<__m512i>(index);
    const __m512d zero = _mm512_setzero_pd();
    low = reinterpret_cast<V>(_mm512_mask_i64gather_pd(zero, 0xff, i, from, 8));
    high = reinterpret_cast<V>(_mm512_mask_i64gather_pd(zero, 0xff, i, from + 1, 8));
    return;
  }
#endif
  if constexpr (kFloat) {
    const auto two = [&](int lane) {  // of lanes `lane` and `lane + 1`
      const __m128 one =
          _mm_castpd_ps(_mm_load_sd(reinterpret_cast<const double*>(from + index[lane])));
      return _mm_loadh_pi(one, reinterpret_cast<const __m64*>(from + index[lane + 1]));
    };
#if defined(__AVX__)
    if constexpr (sizeof(V) == 32) {
      const auto four = [&](int lane) {
        return _mm256_insertf128_ps(_mm256_castps128_ps256(two(lane)), two(lane + 4), 1);
      };
      const __m256 a = four(0), b = four(2);
      low = reinterpret_cast<V>(_mm256_shuffle_ps(a, b, _MM_SHUFFLE(2, 0, 2, 0)));
      high = reinterpret_cast<V>(_mm256_shuffle_ps(a, b, _MM_SHUFFLE(3, 1, 3, 1)));
      return;
    }
#endif
    if constexpr (sizeof(V) == 16) {
      const __m128 a = two(0), b = two(2);
      low = reinterpret_cast<V>(_mm_shuffle_ps(a, b, _MM_SHUFFLE(2, 0, 2, 0)));
      high = reinterpret_cast<V>(_mm_shuffle_ps(a, b, _MM_SHUFFLE(3, 1, 3, 1)));
      return;
    }
  }
#endif
  for (unsigned lane = 0; lane < sizeof(V) / sizeof(Lane<V>); ++lane) {
    low[lane] = from[index[lane]];
    high[lane] = from[index[lane] + 1];
  }
}

// Where lanes are in a grid: along each axis, from the lower to the upper of the nodes around, at
// integers [0] and at half-integers [1].
template <class V, int D>
struct Place {
  std::array<std::array<V, D>, 2> fraction;
  std::array<std::array<Indices<V>, D>, 2> lower;  // number of the lower node, times its stride

  // x [cells] must be in the box.
  SUBSTEP_INLINE Place(const std::array<V, D>& x, const Layout<D>& layout) {
    using Real = Lane<V>;
    using I = Indices<V>;
    using Int = Lane<I>;
    for (std::size_t d = 0; d < D; ++d) {
      const auto step = static_cast<Int>(layout.stride[d]);
      const V last = splat<V>(static_cast<Real>(layout.cells[d] - 1));
      const I own = __builtin_convertvector(x[d] < last ? x[d] : last, I);
      const I half = __builtin_convertvector(x[d] + Real(0.5), I);  // of the node above
      fraction[0][d] = x[d] - __builtin_convertvector(own, V);
      fraction[1][d] = (x[d] - __builtin_convertvector(half, V)) + Real(0.5);
      lower[0][d] = own * step;
      lower[1][d] = half * step - step;
    }
  }
};

// The same of kRows rows at once: from `field`, and from rows[r] after it. Lanes that are
// neighbours mostly look into the same places of memory: what some of them need is read from there
// and put where it belongs. size: numbers in the field.
template <class V, int kRows>
SUBSTEP_INLINE void load_pairs(const Lane<V>* field, const std::array<std::int64_t, kRows>& rows,
                               const Indices<V>& index, [[maybe_unused]] std::int64_t size, V* low,
                               V* high) {
#if defined(__AVX512F__)
  if constexpr (sizeof(V) == 64) {
    constexpr bool kFloat = sizeof(Lane<V>) == 4;
    constexpr int kLanes = kFloat ? 16 : 8, kGroups = 3;
    constexpr unsigned kAll = (1U << kLanes) - 1;
    const std::int64_t last = size - 2 * kLanes - rows[kRows - 1];
    unsigned left = last < 0 ? 0 : kAll;
    for (int group = 0; left != 0 && group < kGroups; ++group) {
      const std::int64_t at = index[__builtin_ctz(left)] - kLanes / 2;
      const std::int64_t base = at < 0 ? 0 : at > last ? last : at;
      const Indices<V> lower = index - static_cast<Lane<Indices<V>>>(base), upper = lower + 1;
      const __m512i l = reinterpret_cast<__m512i>(lower), u = reinterpret_cast<__m512i>(upper);
      unsigned here;
      if constexpr (kFloat) {
        here = left & _mm512_cmplt_epu32_mask(l, _mm512_set1_epi32(2 * kLanes - 1));
      } else {
        here = left & _mm512_cmplt_epu64_mask(l, _mm512_set1_epi64(2 * kLanes - 1));
      }
      for (int r = 0; r < kRows; ++r) {
        const Lane<V>* from = field + rows[usize(r)] + base;
        const V a = load<V>(from), b = load<V>(from + kLanes);
        const auto put = [&](const __m512i& which, V& to) __attribute__((always_inline)) {
          if constexpr (kFloat) {
            const __m512 x = _mm512_permutex2var_ps(reinterpret_cast<__m512>(a), which,
                                                    reinterpret_cast<__m512>(b));
            to = reinterpret_cast<V>(
                _mm512_mask_mov_ps(reinterpret_cast<__m512>(to), static_cast<__mmask16>(here), x));
          } else {
            const __m512d x = _mm512_permutex2var_pd(reinterpret_cast<__m512d>(a), which,
                                                     reinterpret_cast<__m512d>(b));
            to = reinterpret_cast<V>(
                _mm512_mask_mov_pd(reinterpret_cast<__m512d>(to), static_cast<__mmask8>(here), x));
          }
        };
        put(l, low[r]);
        put(u, high[r]);
      }
      left &= ~here;
    }
    if (last >= 0 && left == 0) return;
  }
#endif
  for (int r = 0; r < kRows; ++r) {
    load_pairs<V>(field + rows[usize(r)], index, low[r], high[r]);
  }
}

// The numbers around places: those below and above along the last axis, in each of the rows around,
// of which the second is above along the axis before, and the third along the first; and how far
// the places are between them.
template <class V, int D>
struct Corners {
  static constexpr int kRows = 1 << (D - 1);
  std::array<V, D> f;
  V low[kRows], high[kRows];

  // `component`: across which axis the field's nodes are at integers, -1: none (cell centres), D:
  // all (lower corners of cells).
  SUBSTEP_INLINE Corners(const Lane<V>* field, const Layout<D>& layout, int component,
                         const Place<V, D>& place) {
    Indices<V> index = Indices<V>{} + static_cast<Lane<Indices<V>>>(layout.first);
    for (int d = 0; d < D; ++d) {
      const std::size_t half = d == component || component == D ? 0 : 1;
      f[usize(d)] = place.fraction[half][usize(d)];
      index += place.lower[half][usize(d)];
    }
    std::array<std::int64_t, kRows> rows;
    for (int r = 0; r < kRows; ++r) {
      rows[usize(r)] = (r & 1) * layout.stride[D - 2] + (D == 3 ? r / 2 : 0) * layout.stride[0];
      low[r] = high[r] = V{};
    }
    load_pairs<V, kRows>(field, rows, index, layout.size, low, high);
  }
};

// A field at the places, and its gradient [1/cell] where that is wanted.
template <class V, int D>
SUBSTEP_INLINE V interpolate(const Corners<V, D>& corners,
                             std::type_identity_t<std::array<V, D>>* gradient = nullptr) {
  const std::array<V, D>& f = corners.f;
  // Along the last axis, for each of the rows around; then across.
  constexpr int kRows = Corners<V, D>::kRows;
  V value[kRows], slope[kRows];
  for (int r = 0; r < kRows; ++r) {
    slope[r] = corners.high[r] - corners.low[r];
    value[r] = fma<V>(f[D - 1], slope[r], corners.low[r]);
  }
  const auto mix = [](const V& way, const V& low, const V& high)
                       __attribute__((always_inline)) { return fma<V>(way, high - low, low); };
  if constexpr (D == 2) {
    if (gradient != nullptr) *gradient = {value[1] - value[0], mix(f[0], slope[0], slope[1])};
    return mix(f[0], value[0], value[1]);
  } else {
    const V low = mix(f[1], value[0], value[1]), high = mix(f[1], value[2], value[3]);
    if (gradient != nullptr) {
      *gradient = {high - low, mix(f[0], value[1] - value[0], value[3] - value[2]),
                   mix(f[0], mix(f[1], slope[0], slope[1]), mix(f[1], slope[2], slope[3]))};
    }
    return mix(f[0], low, high);
  }
}
template <class V, int D>
SUBSTEP_INLINE V interpolate(const Lane<V>* field, const Layout<D>& layout, int component,
                             const Place<V, D>& place,
                             std::type_identity_t<std::array<V, D>>* gradient = nullptr) {
  return interpolate<V, D>(Corners<V, D>(field, layout, component, place), gradient);
}

}  // namespace substep::gridfluid
