// Linear combinations of stages with the constants of a tableau, unrolled over the stages.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

#include "substep/core/tableau.h"

namespace substep::ode {

using namespace tableaux;

// a b + c, with one rounding where the level has the instruction.
[[gnu::always_inline]] inline double multiply_add(double a, double b, double c) {
#ifdef __FMA__
  return __builtin_fma(a, b, c);
#else
  return a * b + c;
#endif
}

// Rows of a tableau as types.
template <class T, int S>
struct StageRow {
  static constexpr int count = S;
  static constexpr double at(int j) { return T::a[S][j]; }
};
template <class T>
struct WeightRow {
  static constexpr int count = T::stages;
  static constexpr double at(int j) { return T::b[j]; }
};
template <class T>
struct EmbeddedRow {
  static constexpr int count = T::stages + 1;
  static constexpr double at(int j) { return T::e[j]; }
};
template <class T>
struct ThirdOrderRow {
  static constexpr int count = T::stages;
  static constexpr double at(int j) { return T::e3[j]; }
};
template <class T>
struct FifthOrderRow {
  static constexpr int count = T::stages;
  static constexpr double at(int j) { return T::e5[j]; }
};
template <class T, int R>
struct DenseRow {
  static constexpr int count = T::all_stages;
  static constexpr double at(int j) { return T::d[R][j]; }
};

// Index of the last nonzero constant before `end`, -1 if there is none.
template <class Row>
constexpr int last_nonzero(int end) {
  int j = end - 1;
  while (j >= 0 && Row::at(j) == 0.0) --j;
  return j;
}

// sum_{j < End} row_j k[j][i], in rising j, zeros skipped.
template <class Row, int End = Row::count, class Stages>
[[gnu::always_inline]] inline double weighted_sum(const Stages& k, std::int64_t i) {
  constexpr int j = last_nonzero<Row>(End);
  if constexpr (j < 0) {
    return 0.0;
  } else if constexpr (last_nonzero<Row>(j) < 0) {
    return Row::at(j) * k[j][i];
  } else {
    return multiply_add(Row::at(j), k[j][i], weighted_sum<Row, j>(k, i));
  }
}

// y_i + h sum_j row_j k[j][i]. The last stage comes in last and alone: it is the one that is waited
// for.
template <class Row, class Stages>
[[gnu::always_inline]] inline double increment(double y, double h, const Stages& k,
                                               std::int64_t i) {
  constexpr int j = last_nonzero<Row>(Row::count);
  if constexpr (last_nonzero<Row>(j) < 0) {
    return multiply_add(h * Row::at(j), k[j][i], y);
  } else {
    const double before = multiply_add(h, weighted_sum<Row, j>(k, i), y);
    return multiply_add(h * Row::at(j), k[j][i], before);
  }
}

// One step of N components whose stages stay in registers; k[0] = f(t, y) is given.
template <class T, int S = 1, int N, class F>
[[gnu::always_inline]] inline void unrolled_step(double t, double h, const double (&y)[N],
                                                 double (&k)[T::stages][N], double (&y_new)[N],
                                                 F&& f) {
  if constexpr (S < T::stages) {
    double w[N];
    for (int i = 0; i < N; ++i) w[i] = increment<StageRow<T, S>>(y[i], h, k, i);
    f(t + T::c[S] * h, w, k[S]);
    unrolled_step<T, S + 1>(t, h, y, k, y_new, f);
  } else {
    for (int i = 0; i < N; ++i) y_new[i] = increment<WeightRow<T>>(y[i], h, k, i);
  }
}

inline bool all_finite(const double* y, std::int64_t n) {
  constexpr std::uint64_t kExponent = 0x7ff0000000000000u;
  std::uint64_t bad = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    bad |= std::uint64_t{(std::bit_cast<std::uint64_t>(y[i]) & kExponent) == kExponent};
  }
  return bad == 0;
}

}  // namespace substep::ode
