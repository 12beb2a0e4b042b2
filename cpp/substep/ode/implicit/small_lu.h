// P A = L U by columns with partial pivoting, for matrices of few rows: inlined, no calls, no
// allocations. Golub, van Loan, "Matrix Computations", 4th ed., algorithm 3.4.1.
#pragma once

#include <cmath>
#include <cstdint>

namespace substep::ode {

// Without the checks for NaN that std::complex's product and quotient make.
struct Complex {
  double re = 0.0, im = 0.0;

  Complex& operator-=(Complex b) { return re -= b.re, im -= b.im, *this; }
  Complex& operator*=(Complex b) { return *this = {re * b.re - im * b.im, re * b.im + im * b.re}; }
  friend Complex operator*(Complex a, Complex b) { return a *= b; }
};

inline double magnitude(double a) { return std::fabs(a); }
inline double magnitude(Complex a) { return std::fabs(a.re) + std::fabs(a.im); }
inline double reciprocal(double a) { return 1.0 / a; }
inline Complex reciprocal(Complex a) {  // scaled, so that squares do not overflow
  const double s = 1.0 / magnitude(a), re = a.re * s, im = a.im * s;
  const double d = s / (re * re + im * im);
  return {re * d, -im * d};
}

// a[j * n + i] = A_ij is overwritten by L and U, the diagonal by its reciprocals. Returns the first
// column whose pivot is 0 or not finite, -1 if there is none.
template <class T>
[[gnu::always_inline]] inline std::int64_t lu_factor(std::int64_t n, T* a, std::int32_t* pivot) {
  for (std::int64_t k = 0; k < n; ++k) {
    T* column = a + k * n;
    std::int64_t p = k;
    for (std::int64_t i = k + 1; i < n; ++i) {
      if (magnitude(column[i]) > magnitude(column[p])) p = i;
    }
    const double size = magnitude(column[p]);
    if (!(size > 0.0 && size < HUGE_VAL)) return k;
    pivot[k] = static_cast<std::int32_t>(p);
    if (p != k) {
      for (std::int64_t j = 0; j < n; ++j) {
        const T other = a[j * n + p];
        a[j * n + p] = a[j * n + k];
        a[j * n + k] = other;
      }
    }
    const T inverse = column[k] = reciprocal(column[k]);
    for (std::int64_t i = k + 1; i < n; ++i) column[i] *= inverse;
    for (std::int64_t j = k + 1; j < n; ++j) {
      const T factor = a[j * n + k];
      for (std::int64_t i = k + 1; i < n; ++i) a[j * n + i] -= factor * column[i];
    }
  }
  return -1;
}

// b becomes A^-1 b.
template <class T>
[[gnu::always_inline]] inline void lu_solve(std::int64_t n, const T* a, const std::int32_t* pivot,
                                            T* b) {
  for (std::int64_t k = 0; k < n; ++k) {
    const std::int64_t p = pivot[k];
    const T other = b[p];
    b[p] = b[k];
    b[k] = other;
  }
  for (std::int64_t k = 0; k < n; ++k) {
    for (std::int64_t i = k + 1; i < n; ++i) b[i] -= a[k * n + i] * b[k];
  }
  for (std::int64_t k = n - 1; k >= 0; --k) {
    b[k] *= a[k * n + k];
    for (std::int64_t i = 0; i < k; ++i) b[i] -= a[k * n + i] * b[k];
  }
}

}  // namespace substep::ode
