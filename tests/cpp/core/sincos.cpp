#include "substep/core/sincos.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "substep/core/random.h"

namespace {

using namespace substep;

// Distance of a from the exact value in units in the last place of the exact value.
template <class T>
double ulps(T a, long double exact) {
  const T near = static_cast<T>(exact);
  const T next = std::nextafter(std::abs(near), std::numeric_limits<T>::infinity());
  const long double ulp = static_cast<long double>(next) - std::abs(near);
  return static_cast<double>(std::abs(static_cast<long double>(a) - exact) / ulp);
}

template <class T>
struct Worst {
  double sine = 0, cosine = 0, absolute = 0;

  void look(const T* x) {
    using V = Vector<T>;
    constexpr int kLanes = sizeof(V) / sizeof(T);
    V in, s, c;
    for (int i = 0; i < kLanes; ++i) in[i] = x[i];
    Sincos<V>{}(in, s, c);
    for (int i = 0; i < kLanes; ++i) {
      // x87: 64 bits of mantissa, argument reduced by the library with all of pi.
      const long double exact_s = std::sin(static_cast<long double>(x[i]));
      const long double exact_c = std::cos(static_cast<long double>(x[i]));
      sine = std::max(sine, ulps<T>(s[i], exact_s));
      cosine = std::max(cosine, ulps<T>(c[i], exact_c));
      absolute = std::max({absolute, static_cast<double>(std::abs(s[i] - exact_s)),
                           static_cast<double>(std::abs(c[i] - exact_c))});
    }
  }
};

template <class T>
void compare(double range, double bound) {
  Worst<T> worst;
  for (std::uint64_t i = 0; i < 400000; i += 16) {
    T x[16];
    for (std::uint64_t k = 0; k < 16; ++k) {
      x[k] = static_cast<T>((2 * substep::uniform2(7, i + k)[0] - 1) * range);
    }
    for (int k = 0; k < 16; k += static_cast<int>(sizeof(Vector<T>) / sizeof(T))) worst.look(x + k);
  }
  EXPECT_LE(worst.sine, bound) << "within " << range;
  EXPECT_LE(worst.cosine, bound) << "within " << range;
  EXPECT_LE(worst.absolute, std::numeric_limits<T>::epsilon()) << "within " << range;
}

#ifdef __FMA__
constexpr bool kFma = true;
#else
constexpr bool kFma = false;  // float products are rounded, which shows near multiples of pi/2
#endif
constexpr double kAny = std::numeric_limits<double>::infinity();

TEST(Sincos, ErrorInUlp) {
  for (const double range : {0.8, 4.0, 100.0}) compare<double>(range, 2);
  for (const double range : {1e4, 1e6}) compare<double>(range, 2.5);
  for (const double range : {0.8, 4.0, 100.0}) compare<float>(range, 2);
  compare<float>(8192, kFma ? 2.5 : kAny);
}

// Next to multiples of pi/2 the reduced argument is tiny and shows every bit of pi that is missing.
template <class T>
void compare_near_multiples(int last, double bound) {
  Worst<T> worst;
  for (int q = 1; q + 16 < last; q += 16) {
    T x[16];
    for (int k = 0; k < 16; ++k) x[k] = static_cast<T>((q + k) * 1.57079632679489661923L);
    for (int k = 0; k < 16; k += static_cast<int>(sizeof(Vector<T>) / sizeof(T))) worst.look(x + k);
  }
  EXPECT_LE(worst.sine, bound);
  EXPECT_LE(worst.cosine, bound);
  EXPECT_LE(worst.absolute, std::numeric_limits<T>::epsilon());
}

TEST(Sincos, NearMultiplesOfHalfPi) {
  compare_near_multiples<double>(6000, 2);
  compare_near_multiples<double>(600000, 4);
  compare_near_multiples<float>(5200, kFma ? 2 : kAny);
}

TEST(Sincos, BeyondTheRangeIsTheLibrarys) {
  using V = Vector<double>;
  V x, s, c;
  for (unsigned i = 0; i < sizeof(V) / 8; ++i) x[i] = i % 2 ? 0.5 : 3e15 + i;
  Sincos<V>{}(x, s, c);
  for (unsigned i = 0; i < sizeof(V) / 8; i += 2) {
    EXPECT_EQ(s[i], std::sin(x[i]));
    EXPECT_EQ(c[i], std::cos(x[i]));
  }
  EXPECT_LE(ulps<double>(s[1], std::sin(0.5L)), 2.0);
}

TEST(Sincos, NotFiniteGivesNan) {
  using V = Vector<double>;
  V x{}, s, c;
  x[0] = std::numeric_limits<double>::infinity();
  x[1] = std::nan("");
  Sincos<V>{}(x, s, c);
  EXPECT_TRUE(std::isnan(s[0]) && std::isnan(c[0]));
  EXPECT_TRUE(std::isnan(s[1]) && std::isnan(c[1]));
}

// The bits of a lane do not depend on the other lanes.
TEST(Sincos, LanesAreIndependent) {
  using V = Vector<double>;
  V many, s, c;
  constexpr int kLanes = sizeof(V) / 8;
  for (int i = 0; i < kLanes; ++i) many[i] = 0.37 * i * i - 2e6 * (i % 2);
  Sincos<V>{}(many, s, c);
  for (int i = 0; i < kLanes; ++i) {
    V s1, c1;
    Sincos<V>{}(splat<V>(many[i]), s1, c1);
    EXPECT_EQ(s1[0], s[i]);
    EXPECT_EQ(c1[0], c[i]);
  }
}

}  // namespace
