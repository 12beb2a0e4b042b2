// sin and cos together, without branches, for vectors of lanes. Error at most, in units in the last
// place (tests/cpp/core/sincos.cpp): double 2 for |x| <= 100, 2.5 to the limit of 1e6 (4 next to
// multiples of pi/2); float 2 for |x| <= 100, 2.5 to the limit of 8192, and without FMA 2^-24
// absolute there. A lane beyond the limit is handed to the C library.
//
// x = q pi/2 + r, q the nearest integer; pi/2 is split as p1 + p2 + p3 (+ p4) so that q p1 is exact
// (Cody and Waite 1980, "Software Manual for the Elementary Functions", ch. 8); polynomials of
// FDLIBM k_sin.c, k_cos.c (double) and of Cephes sinf.c (float) on |r| <= pi/4.
#pragma once

#include <cmath>

#include "substep/core/lanes.h"

namespace substep {

template <class T>
inline constexpr T kSincosLimit = sizeof(T) == 8 ? T(1e6) : T(8192);

template <class V>
SUBSTEP_INLINE void sincos_within_limit(const V& x, V& sine, V& cosine) {
  using T = Lane<V>;
  using I = std::remove_cvref_t<decltype(x < x)>;
  constexpr bool kDouble = sizeof(T) == 8;
  constexpr int kSignBit = sizeof(T) * 8 - 1;
  // Adding 1.5 * 2^(mantissa bits) rounds to an integer and leaves it in the low bits.
  constexpr T kMagic = kDouble ? T(0x1.8p52) : T(0x1.8p23);
  const V shifted = fma(T(0.63661977236758134308), x, splat<V>(kMagic));
  const I quadrant = reinterpret_cast<I>(shifted);
  const V q = shifted - kMagic;
  V r;
  if constexpr (kDouble) {  // FDLIBM e_rem_pio2.c: pio2_1, pio2_2 of 33 bits each, pio2_3 + tail
    r = fma(T(-0x1.921fb544p0), q, x);
    r = fma(T(-0x1.0b4611a6p-34), q, r);
    r = fma(T(-0x1.3198a2e037073p-69), q, r);
  } else {
    r = fma(T(-0x1.92p0), q, x);
    r = fma(T(-0x1.fb4p-12), q, r);
    r = fma(T(-0x1.4442p-24), q, r);
    r = fma(T(-0x1.a308d4p-41), q, r);
  }
  const V z = r * r;
  V ps, pc;
  if constexpr (kDouble) {
    ps = fma(z, splat<V>(T(1.58969099521155010221e-10)), T(-2.50507602534068634195e-08));
    ps = fma(z, ps, T(2.75573137070700676789e-06));
    ps = fma(z, ps, T(-1.98412698298579493134e-04));
    ps = fma(z, ps, T(8.33333333332248946124e-03));
    ps = fma(z, ps, T(-1.66666666666666324348e-01));
    pc = fma(z, splat<V>(T(-1.13596475577881948265e-11)), T(2.08757232129817482790e-09));
    pc = fma(z, pc, T(-2.75573143513906633035e-07));
    pc = fma(z, pc, T(2.48015872894767294178e-05));
    pc = fma(z, pc, T(-1.38888888888741095749e-03));
    pc = fma(z, pc, T(4.16666666666666019037e-02));
  } else {
    ps = fma(z, splat<V>(T(-1.9515295891e-4)), T(8.3321608736e-3));
    ps = fma(z, ps, T(-1.6666654611e-1));
    pc = fma(z, splat<V>(T(2.443315711809948e-5)), T(-1.388731625493765e-3));
    pc = fma(z, pc, T(4.166664568298827e-2));
  }
  ps = fma(r * z, ps, r);
  pc = fma(z, fma(z, pc, T(-0.5)), T(1));
  const I swap = (quadrant & 1) != 0;
  sine = swap ? pc : ps;
  cosine = swap ? ps : pc;
  const I sign = (I{} + 1) << kSignBit;
  const I minus_s = (quadrant << (kSignBit - 1)) & sign;  // bit 1 of the quadrant
  const I minus_c = ((quadrant + 1) << (kSignBit - 1)) & sign;
  sine = reinterpret_cast<V>(reinterpret_cast<I>(sine) ^ minus_s);
  cosine = reinterpret_cast<V>(reinterpret_cast<I>(cosine) ^ minus_c);
}

// Any argument: lanes beyond the limit by the C library.
template <class V>
struct Sincos {
  SUBSTEP_INLINE void operator()(const V& x, V& sine, V& cosine) const {
    using T = Lane<V>;
    sincos_within_limit(x, sine, cosine);
    if (all_within(x, splat<V>(-kSincosLimit<T>), splat<V>(kSincosLimit<T>))) return;
    for (unsigned lane = 0; lane < sizeof(V) / sizeof(T); ++lane) {
      if (std::abs(x[lane]) <= kSincosLimit<T>) continue;
      sine[lane] = std::sin(x[lane]);
      cosine[lane] = std::cos(x[lane]);
    }
  }
};

// Takes all arguments for within the limit, and tells afterwards whether they were.
template <class V>
struct FastSincos {
  V largest{};

  SUBSTEP_INLINE void operator()(const V& x, V& sine, V& cosine) {
    using I = std::remove_cvref_t<decltype(x < x)>;
    constexpr int kSignBit = sizeof(Lane<V>) * 8 - 1;
    sincos_within_limit(x, sine, cosine);
    const V size = reinterpret_cast<V>(reinterpret_cast<I>(x) & ~((I{} + 1) << kSignBit));
    largest = size > largest ? size : largest;
  }
  SUBSTEP_INLINE bool was_beyond() const { return any(largest > kSincosLimit<Lane<V>>); }
};

}  // namespace substep
