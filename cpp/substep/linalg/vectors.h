// Sums over long vectors, the same bits for any number of threads: partial sums over chunks of
// fixed length, added in order.
#pragma once

#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep {

inline constexpr std::int64_t kSumChunk = 8192;

// Adds term(i) for i in [begin, end) in eight interleaved sums, which fit a vector register.
template <class T, class Term>
T sum_chunk(std::int64_t begin, std::int64_t end, const Term& term) {
  std::array<T, 8> lane{};
  std::int64_t i = begin;
  for (; i + 8 <= end; i += 8) {
    for (std::size_t l = 0; l < 8; ++l) lane[l] += term(usize(i) + l);
  }
  for (; i < end; ++i) lane[0] += term(usize(i));
  return ((lane[0] + lane[4]) + (lane[2] + lane[6])) + ((lane[1] + lane[5]) + (lane[3] + lane[7]));
}

template <class T, class Term>
T sum_terms(std::int64_t n, const Term& term, int threads = 1) {
  if (n <= kSumChunk) return sum_chunk<T>(0, n, term);
  std::vector<T> part(usize((n - 1) / kSumChunk + 1));
  parallel_for(
      n, kSumChunk,
      [&](std::int64_t begin, std::int64_t end) {
        part[usize(begin / kSumChunk)] = sum_chunk<T>(begin, end, term);
      },
      threads);
  T sum{};
  for (const T& p : part) sum += p;
  return sum;
}

// conj(x) . y
inline double dot(std::span<const double> x, std::span<const double> y, int threads = 1) {
  return sum_terms<double>(
      static_cast<std::int64_t>(x.size()), [=](std::size_t i) { return x[i] * y[i]; }, threads);
}
inline std::complex<double> dot(std::span<const std::complex<double>> x,
                                std::span<const std::complex<double>> y, int threads = 1) {
  return sum_terms<std::complex<double>>(
      static_cast<std::int64_t>(x.size()),
      [=](std::size_t i) {
        const double a = x[i].real(), b = x[i].imag(), c = y[i].real(), d = y[i].imag();
        return std::complex<double>(a * c + b * d, a * d - b * c);
      },
      threads);
}

template <class T>
double norm2(std::span<const T> x, int threads = 1) {
  return std::sqrt(std::real(dot(x, x, threads)));
}

// Calls body(i) for every i of a long vector.
template <class Body>
void for_each_index(std::size_t n, int threads, const Body& body) {
  parallel_for(
      static_cast<std::int64_t>(n), kSumChunk,
      [&](std::int64_t begin, std::int64_t end) {
        for (auto i = usize(begin); i < usize(end); ++i) {
          body(i);
        }
      },
      threads);
}

}  // namespace substep
