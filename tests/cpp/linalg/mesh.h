// The matrix that the tests of linalg solve with.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "substep/core/usize.h"
#include "substep/linalg/sparse.h"

namespace substep {

// The 5-point Laplacian with 3 unknowns a vertex that are coupled too, plus a shift; `skew` makes
// it unsymmetric.
template <class T>
struct Mesh {
  SparsePattern pattern;
  std::vector<T> values;
};

template <class T>
Mesh<T> mesh(int side, bool lower, double shift, double skew) {
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  std::vector<T> contributions;
  const auto couple = [&](int u, int v) {
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) {
        const int i = 3 * u + r, j = 3 * v + c;
        if (lower && i < j) continue;
        const double weight = u == v ? (r == c ? 4 + shift : 0.5) : (r == c ? -1 : -0.1);
        pairs.emplace_back(i, j);
        contributions.push_back(T(weight) + T(i < j ? skew : -skew));
      }
    }
  };
  for (int a = 0; a < side; ++a) {
    for (int b = 0; b < side; ++b) {
      const int v = a * side + b;
      couple(v, v);
      if (b + 1 < side) couple(v, v + 1), couple(v + 1, v);
      if (a + 1 < side) couple(v, v + side), couple(v + side, v);
    }
  }
  Mesh<T> result;
  std::vector<std::int32_t> slots;
  result.pattern = build_pattern(3 * side * side, 3 * side * side, pairs, &slots);
  result.values.resize(result.pattern.row.size());
  for (std::size_t k = 0; k < slots.size(); ++k) {
    result.values[usize(slots[k])] += contributions[k];
  }
  return result;
}

template <class T>
std::vector<T> right_side(std::size_t n) {
  std::vector<T> b(n);
  for (std::size_t i = 0; i < n; ++i) b[i] = T(std::sin(0.1 * static_cast<double>(i)) + 0.5);
  return b;
}

// |A x - b|_inf / (|A|_max |x|_inf), with A whole.
template <class T>
double residual(const Mesh<T>& a, const std::vector<T>& x, const std::vector<T>& b) {
  std::vector<T> r(b);
  double size = 0, norm = 0;
  for (std::int32_t j = 0; j < a.pattern.cols; ++j) {
    for (auto k = usize(a.pattern.start[usize(j)]); k < usize(a.pattern.start[usize(j) + 1]); ++k) {
      r[usize(a.pattern.row[k])] -= a.values[k] * x[usize(j)];
      size = std::max(size, std::abs(a.values[k]));
    }
  }
  double worst = 0;
  for (std::size_t i = 0; i < r.size(); ++i) {
    worst = std::max(worst, std::abs(r[i]));
    norm = std::max(norm, std::abs(x[i]));
  }
  return worst / (size * norm);
}

}  // namespace substep
