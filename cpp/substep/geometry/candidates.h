// The points of the cells about a cell, gathered by coordinate, and which of them are closer to a
// point than a radius: a comparison of whole vectors, whose lanes that hold are packed together.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>
#include <vector>
#ifdef __x86_64__
#include <immintrin.h>
#endif

#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/geometry/neighbours.h"

namespace substep::geometry {

#if defined(__AVX512F__) && defined(__AVX512VL__) && defined(__AVX512DQ__)
#define SUBSTEP_COMPRESS 16
#elif defined(__AVX2__) && defined(__FMA__)
#define SUBSTEP_COMPRESS 8
#endif

#if defined(SUBSTEP_COMPRESS) && SUBSTEP_COMPRESS == 8
// Row m: the places of the bits that are set in m, in order.
inline constexpr std::array<std::uint64_t, 256> kSetBits = [] {
  std::array<std::uint64_t, 256> rows{};
  for (unsigned mask = 0; mask < 256; ++mask) {
    unsigned place = 0;
    for (std::uint64_t bit = 0; bit < 8; ++bit) {
      if (mask >> bit & 1) rows[mask] |= bit << (8 * place++);
    }
  }
  return rows;
}();
#endif

template <class Real>
class Candidates {
 public:
  static constexpr int kBlock = 16;  // candidates are taken in blocks of so many

  // The points have coordinates in x, y, z, readable for kBlock beyond the last.
  Candidates(const Real* x, const Real* y, const Real* z) : from_{x, y, z} {}

  void clear() { size_ = 0; }
  int size() const { return size_; }

  // Points [begin, end).
  void add(std::int32_t begin, std::int32_t end) {
    const int count = end - begin;
    if (count <= 0) return;
    const auto wanted = usize(size_ + count + 2 * kBlock);
    if (wanted > index_.size()) {
      for (auto& c : x_) c.resize(2 * wanted);
      index_.resize(2 * wanted);
    }
    for (std::size_t a = 0; a < 3; ++a) {
      Real* const to = x_[a].data() + size_;
      const Real* const from = from_[a] + begin;
      for (int k = 0; k < count; k += kBlock) std::memcpy(to + k, from + k, kBlock * sizeof(Real));
    }
    std::int32_t* const index = index_.data() + size_;
    for (int k = 0; k < count; k += kBlock) {
      for (int lane = 0; lane < kBlock; ++lane) index[k + lane] = begin + k + lane;
    }
    size_ += count;
  }

  // Fills the last block up with points infinitely far away.
  void close() {
    if (size_ == 0) return;
    std::fill_n(x_[0].data() + size_, kBlock, std::numeric_limits<Real>::infinity());
  }

  // Writes the indices j of the candidates from place `first` (a multiple of kBlock) on that are
  // closer than the radius, without i itself (half: only those above i); returns their end. It may
  // write kBlock indices beyond it.
  template <Pairs kPairs>
  SUBSTEP_INLINE std::int32_t* append_near(const Real (&p)[3], std::int32_t i, int first,
                                           Real radius_squared, std::int32_t* out) const {
    for (int k = first; k < size_; k += kBlock) {
      out = append_block<kPairs>(p, i, k, radius_squared, out);
    }
    return out;
  }

 private:
#ifdef SUBSTEP_COMPRESS
  template <Pairs kPairs>
  SUBSTEP_INLINE std::int32_t* append_block(const Real (&p)[3], std::int32_t i, int k,
                                            Real radius_squared, std::int32_t* out) const {
#if SUBSTEP_COMPRESS == 16
    const __m512i index = _mm512_loadu_si512(index_.data() + k);
    const __m512i self = _mm512_set1_epi32(i);
    const __mmask16 other = kPairs == Pairs::kHalf ? _mm512_cmpgt_epi32_mask(index, self)
                                                   : _mm512_cmpneq_epi32_mask(index, self);
    const auto mask = static_cast<__mmask16>(near(p, k, radius_squared) & other);
    _mm512_storeu_si512(out, _mm512_maskz_compress_epi32(mask, index));
    return out + std::popcount(static_cast<unsigned>(mask));
#else
    const __m256i self = _mm256_set1_epi32(i);
    for (int half = k; half < k + kBlock; half += 8) {
      const __m256i index =
          _mm256_loadu_si256(reinterpret_cast<const __m256i*>(index_.data() + half));
      const __m256i excluded =
          kPairs == Pairs::kHalf
              ? _mm256_xor_si256(_mm256_cmpgt_epi32(index, self), _mm256_set1_epi32(-1))
              : _mm256_cmpeq_epi32(index, self);
      const int other = ~_mm256_movemask_ps(_mm256_castsi256_ps(excluded));
      const auto mask = static_cast<unsigned>(near(p, half, radius_squared) & other);
      const __m256i places =
          _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(static_cast<std::int64_t>(kSetBits[mask])));
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out),
                          _mm256_permutevar8x32_epi32(index, places));
      out += std::popcount(mask);
    }
    return out;
#endif
  }

  // |x_k - p|^2 of one vector of candidates.
  SUBSTEP_INLINE Vector<Real> distance_squared(const Real (&p)[3], int k) const {
    using V = Vector<Real>;
    const V dx = load<V>(x_[0].data() + k) - splat<V>(p[0]);
    const V dy = load<V>(x_[1].data() + k) - splat<V>(p[1]);
    const V dz = load<V>(x_[2].data() + k) - splat<V>(p[2]);
    return fma(dx, dx, fma(dy, dy, dz * dz));
  }

  // Bit by bit, which of SUBSTEP_COMPRESS candidates are closer than the radius.
  SUBSTEP_INLINE int near(const Real (&p)[3], int k, Real radius_squared) const {
    const auto d = distance_squared(p, k);
#if SUBSTEP_COMPRESS == 16
    if constexpr (std::is_same_v<Real, float>) {
      return _mm512_cmp_ps_mask(reinterpret_cast<__m512>(d), _mm512_set1_ps(radius_squared),
                                _CMP_LT_OQ);
    } else {
      const __m512d bound = _mm512_set1_pd(radius_squared);
      const auto high = distance_squared(p, k + 8);
      return _mm512_cmp_pd_mask(reinterpret_cast<__m512d>(d), bound, _CMP_LT_OQ) |
             _mm512_cmp_pd_mask(reinterpret_cast<__m512d>(high), bound, _CMP_LT_OQ) << 8;
    }
#else
    if constexpr (std::is_same_v<Real, float>) {
      return _mm256_movemask_ps(
          _mm256_cmp_ps(reinterpret_cast<__m256>(d), _mm256_set1_ps(radius_squared), _CMP_LT_OQ));
    } else {
      const __m256d bound = _mm256_set1_pd(radius_squared);
      const auto high = distance_squared(p, k + 4);
      return _mm256_movemask_pd(_mm256_cmp_pd(reinterpret_cast<__m256d>(d), bound, _CMP_LT_OQ)) |
             _mm256_movemask_pd(_mm256_cmp_pd(reinterpret_cast<__m256d>(high), bound, _CMP_LT_OQ))
                 << 4;
    }
#endif
  }
#else
  template <Pairs kPairs>
  SUBSTEP_INLINE std::int32_t* append_block(const Real (&p)[3], std::int32_t i, int k,
                                            Real radius_squared, std::int32_t* out) const {
    for (int c = k; c < k + kBlock; ++c) {
      const auto at = usize(c);
      const Real dx = x_[0][at] - p[0], dy = x_[1][at] - p[1], dz = x_[2][at] - p[2];
      *out = index_[at];
      const bool other = kPairs == Pairs::kHalf ? index_[at] > i : index_[at] != i;
      out += other & (dx * dx + (dy * dy + dz * dz) < radius_squared);
    }
    return out;
  }
#endif

  std::array<const Real*, 3> from_;
  std::array<std::vector<Real>, 3> x_;
  std::vector<std::int32_t> index_;
  int size_ = 0;
};

}  // namespace substep::geometry
