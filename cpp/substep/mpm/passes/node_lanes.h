// Nodes of a stencil's row, a few in a vector: each has four numbers, so a vector holds four, two
// or one of them, by the width of the machine's; and what passes between rows of nodes and lanes of
// particles.
#pragma once

#include <algorithm>
#include <utility>

#include "substep/core/lanes.h"
#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

template <class Real>
using Quad = Vector<Real, 4 * static_cast<int>(sizeof(Real))>;  // the numbers of a node

template <class Real>
using NodeVector = Vector<Real, std::max(kVectorBytes, 4 * static_cast<int>(sizeof(Real)))>;

template <class Real>
struct Row {
  using N = NodeVector<Real>;
  static constexpr int kWidth = static_cast<int>(sizeof(N) / sizeof(Real));
  static constexpr int kPerVector = kWidth / 4;
  static constexpr int kParts = kPerVector == 1 ? 3 : 4 / kPerVector;  // 3 nodes, or 4
  N part[kParts];

  static SUBSTEP_INLINE Row zero() { return Row{}; }
  static SUBSTEP_INLINE Row at(const Real* nodes) {
    Row row;
    for (int p = 0; p < kParts; ++p) row.part[p] = load<N>(nodes + p * kWidth);
    return row;
  }
  SUBSTEP_INLINE void add_to(Real* nodes) const {
    for (int p = 0; p < kParts; ++p) {
      const N sum = load<N>(nodes + p * kWidth) + part[p];
      std::memcpy(nodes + p * kWidth, &sum, sizeof sum);
    }
  }
  // The four numbers at every node.
  static SUBSTEP_INLINE Row repeated(const Real* numbers) {
    Row row;
    row.part[0] = repeated_vector(numbers);
    for (int p = 1; p < kParts; ++p) row.part[p] = row.part[0];
    return row;
  }
  // Number k at all four places of node k.
  static SUBSTEP_INLINE Row spread(const Real* numbers) {
    if constexpr (kPerVector == 1) {
      return {{splat<N>(numbers[0]), splat<N>(numbers[1]), splat<N>(numbers[2])}};
    } else {
      return spread(repeated_vector(numbers), std::make_integer_sequence<int, kParts>());
    }
  }
  // 0, 1, 2, 3: the node's place in the row.
  static SUBSTEP_INLINE Row places() {
    constexpr Real k[4] = {0, 1, 2, 3};
    return spread(k);
  }
  // Of the parts that are nodes.
  SUBSTEP_INLINE Quad<Real> sum_over_nodes() const {
    Quad<Real> sum{};
    for (int k = 0; k < 3; ++k) {
      sum += load<Quad<Real>>(reinterpret_cast<const Real*>(part) + 4 * k);
    }
    return sum;
  }

 private:
  static SUBSTEP_INLINE N repeated_vector(const Real* numbers) {
#ifdef __AVX512F__
    if constexpr (kPerVector == 4) {
      return reinterpret_cast<N>(_mm512_broadcast_f32x4(_mm_loadu_ps(numbers)));
    } else if constexpr (sizeof(N) == 64) {
      return reinterpret_cast<N>(_mm512_broadcast_f64x4(_mm256_loadu_pd(numbers)));
    }
#elif defined(__AVX__)
    if constexpr (kPerVector == 2) {
      return reinterpret_cast<N>(_mm256_broadcast_ps(reinterpret_cast<const __m128*>(numbers)));
    }
#endif
    return load<N>(numbers);
  }
  template <int kPart>
  static SUBSTEP_INLINE N spread_part(const N& repeated) {
    return [&]<int... I>(std::integer_sequence<int, I...>) {
      return __builtin_shufflevector(repeated, repeated, (kPart * kPerVector + I / 4)...);
    }(std::make_integer_sequence<int, kWidth>());
  }
  template <int... kPart>
  static SUBSTEP_INLINE Row spread(const N& repeated, std::integer_sequence<int, kPart...>) {
    return {{spread_part<kPart>(repeated)...}};
  }
};

template <class Real>
SUBSTEP_INLINE Row<Real> operator*(const Row<Real>& a, const Row<Real>& b) {
  Row<Real> c;
  for (int p = 0; p < Row<Real>::kParts; ++p) c.part[p] = a.part[p] * b.part[p];
  return c;
}
template <class Real>
SUBSTEP_INLINE Row<Real> operator*(Real a, const Row<Real>& b) {
  Row<Real> c;
  for (int p = 0; p < Row<Real>::kParts; ++p) c.part[p] = a * b.part[p];
  return c;
}
template <class Real>
SUBSTEP_INLINE Row<Real> operator+(const Row<Real>& a, const Row<Real>& b) {
  Row<Real> c;
  for (int p = 0; p < Row<Real>::kParts; ++p) c.part[p] = a.part[p] + b.part[p];
  return c;
}
template <class Real>
SUBSTEP_INLINE Row<Real> multiply_add(const Row<Real>& a, const Row<Real>& b, const Row<Real>& c) {
  Row<Real> d;
  for (int p = 0; p < Row<Real>::kParts; ++p) d.part[p] = fma(a.part[p], b.part[p], c.part[p]);
  return d;
}
template <class Real>
SUBSTEP_INLINE Row<Real> multiply_add(Real a, const Row<Real>& b, const Row<Real>& c) {
  Row<Real> d;
  for (int p = 0; p < Row<Real>::kParts; ++p) {
    d.part[p] = fma<NodeVector<Real>>(a, b.part[p], c.part[p]);
  }
  return d;
}

// Sums over the nodes of four rows, one after the other: 16 numbers.
template <class Real>
SUBSTEP_INLINE void store_sums(const Row<Real>& a, const Row<Real>& b, const Row<Real>& c,
                               const Row<Real>& d, Real* to) {
  using N = NodeVector<Real>;
  constexpr int kPerVector = Row<Real>::kPerVector;
  if constexpr (kPerVector == 1) {
    const Row<Real>* rows[] = {&a, &b, &c, &d};
    for (int r = 0; r < 4; ++r) {
      const N sum = rows[r]->part[0] + rows[r]->part[1] + rows[r]->part[2];
      std::memcpy(to + 4 * r, &sum, sizeof sum);
    }
  } else if constexpr (kPerVector == 2) {
    const auto both = [](const Row<Real>& x, const Row<Real>& y) -> N {
      const N s = x.part[0] + x.part[1], t = y.part[0] + y.part[1];
      return __builtin_shufflevector(s, t, 0, 1, 2, 3, 8, 9, 10, 11) +
             __builtin_shufflevector(s, t, 4, 5, 6, 7, 12, 13, 14, 15);
    };
    const N first = both(a, b), second = both(c, d);
    std::memcpy(to, &first, sizeof first);
    std::memcpy(to + 8, &second, sizeof second);
  } else {
    const auto halves = [](const N& s, const N& t) -> N {
      return __builtin_shufflevector(s, t, 0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23) +
             __builtin_shufflevector(s, t, 8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30,
                                     31);
    };
    const N s = halves(a.part[0], b.part[0]), t = halves(c.part[0], d.part[0]);
    const N sum =
        __builtin_shufflevector(s, t, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27) +
        __builtin_shufflevector(s, t, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
    std::memcpy(to, &sum, sizeof sum);
  }
}

// Four quads, seen from the other side.
template <class Real>
SUBSTEP_INLINE void transpose4(Quad<Real> (&q)[4]) {
  const Quad<Real> a = __builtin_shufflevector(q[0], q[1], 0, 4, 1, 5);
  const Quad<Real> b = __builtin_shufflevector(q[0], q[1], 2, 6, 3, 7);
  const Quad<Real> c = __builtin_shufflevector(q[2], q[3], 0, 4, 1, 5);
  const Quad<Real> d = __builtin_shufflevector(q[2], q[3], 2, 6, 3, 7);
  q[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
  q[1] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
  q[2] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
  q[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

#ifdef __AVX512F__
// 16 x 16, stored by rows.
SUBSTEP_INLINE void transpose16(const float* from, float* to) {
  __m512 a[16], b[16];
  for (int i = 0; i < 16; ++i) a[i] = _mm512_load_ps(from + 16 * i);
  for (int i = 0; i < 16; i += 2) {
    b[i] = _mm512_unpacklo_ps(a[i], a[i + 1]);
    b[i + 1] = _mm512_unpackhi_ps(a[i], a[i + 1]);
  }
  for (int i = 0; i < 16; i += 4) {
    a[i] = _mm512_shuffle_ps(b[i], b[i + 2], 0x44);
    a[i + 1] = _mm512_shuffle_ps(b[i], b[i + 2], 0xEE);
    a[i + 2] = _mm512_shuffle_ps(b[i + 1], b[i + 3], 0x44);
    a[i + 3] = _mm512_shuffle_ps(b[i + 1], b[i + 3], 0xEE);
  }
  for (int c = 0; c < 4; ++c) {  // quad q of a[4 g + c]: numbers 4 g to 4 g + 3 of row 4 q + c
    const __m512 s = _mm512_shuffle_f32x4(a[c], a[4 + c], 0x88);
    const __m512 t = _mm512_shuffle_f32x4(a[c], a[4 + c], 0xDD);
    const __m512 u = _mm512_shuffle_f32x4(a[8 + c], a[12 + c], 0x88);
    const __m512 v = _mm512_shuffle_f32x4(a[8 + c], a[12 + c], 0xDD);
    _mm512_store_ps(to + 16 * c, _mm512_shuffle_f32x4(s, u, 0x88));
    _mm512_store_ps(to + 16 * (4 + c), _mm512_shuffle_f32x4(t, v, 0x88));
    _mm512_store_ps(to + 16 * (8 + c), _mm512_shuffle_f32x4(s, u, 0xDD));
    _mm512_store_ps(to + 16 * (12 + c), _mm512_shuffle_f32x4(t, v, 0xDD));
  }
}
#endif

// The 4 kQuads first of 16 numbers of each lane's particle, to the lanes of as many vectors, and
// back. Both aligned to 64 bytes.
template <class Real, int kQuads>
SUBSTEP_INLINE void to_lanes(const Real* numbers, Real* vectors) {
  constexpr int kWidth = kLanes<Real>;
#ifdef __AVX512F__
  if constexpr (kWidth == 16) return transpose16(numbers, vectors);
#endif
  constexpr int kSide = kWidth < 4 ? kWidth : 4;
  for (int quad = 0; quad < kQuads; ++quad) {
    for (int lane = 0; lane < kWidth; lane += kSide) {
      Quad<Real> q[4] = {};
      for (int i = 0; i < kSide; ++i) q[i] = load<Quad<Real>>(numbers + 16 * (lane + i) + 4 * quad);
      transpose4<Real>(q);
      for (int i = 0; i < 4; ++i) {
        std::memcpy(vectors + kWidth * (4 * quad + i) + lane, &q[i], kSide * sizeof(Real));
      }
    }
  }
}
template <class Real, int kQuads>
SUBSTEP_INLINE void from_lanes(const Real* vectors, Real* numbers) {
  constexpr int kWidth = kLanes<Real>;
#ifdef __AVX512F__
  if constexpr (kWidth == 16) return transpose16(vectors, numbers);
#endif
  constexpr int kSide = kWidth < 4 ? kWidth : 4;
  for (int quad = 0; quad < kQuads; ++quad) {
    for (int lane = 0; lane < kWidth; lane += kSide) {
      Quad<Real> q[4] = {};
      for (int i = 0; i < 4; ++i) {
        std::memcpy(&q[i], vectors + kWidth * (4 * quad + i) + lane, kSide * sizeof(Real));
      }
      transpose4<Real>(q);
      for (int i = 0; i < kSide; ++i) {
        std::memcpy(numbers + 16 * (lane + i) + 4 * quad, &q[i], sizeof q[i]);
      }
    }
  }
}

}  // namespace substep::mpm
