// The product of the matrix of the pressure with a vector, row by row.
#pragma once

#include <array>
#include <cstring>
#include <span>

#include "substep/core/lanes.h"
#include "substep/gridfluid/grid/rows.h"

namespace substep::gridfluid {

// n numbers as doubles.
template <int kLanes, class Real>
SUBSTEP_INLINE Vector<double, kLanes * 8> doubles(const Real* from) {
  return __builtin_convertvector(load<Vector<Real, kLanes* int(sizeof(Real))>>(from),
                                 Vector<double, kLanes * 8>);
}
template <int kLanes, class Real>
SUBSTEP_INLINE void store(const Vector<double, kLanes * 8>& v, Real* to) {
  using Narrow = Vector<Real, kLanes* int(sizeof(Real))>;
  const Narrow narrow = __builtin_convertvector(v, Narrow);
  std::memcpy(to, &narrow, sizeof narrow);
}

// The sum of term<kLanes>(i), lanes of doubles, over [0, n).
template <class Term>
SUBSTEP_INLINE double sum_over(int n, const Term& term) {
  constexpr int kDoubles = kVectorBytes / 8;
  Vector<double, kDoubles * 8> sums{};
  int i = 0;
  for (; i + kDoubles <= n; i += kDoubles) sums += term.template operator()<kDoubles>(i);
  double sum = 0;
  for (int lane = 0; lane < kDoubles; ++lane) sum += sums[lane];
  for (; i < n; ++i) sum += term.template operator()<1>(i)[0];
  return sum;
}

// A x for lanes of cells from i on: the differences and their sum in double.
template <int kLanes, int D, class Real, class X>
SUBSTEP_INLINE Vector<double, kLanes * 8> product(
    const std::array<std::span<const Real>, std::size_t{D}>& w, const Row<D>& row, const X* x,
    int i) {
  using V = Vector<double, kLanes * 8>;
  const X* const here = x + row.at + i;
  const Real* const along = w[D - 1].data() + row.at + i;
  const V own = doubles<kLanes>(here);
  V sum = doubles<kLanes>(along) * (own - doubles<kLanes>(here - 1)) +
          doubles<kLanes>(along + 1) * (own - doubles<kLanes>(here + 1));
  for (std::size_t a = 0; a < D - 1; ++a) {
    sum +=
        doubles<kLanes>(w[a].data() + row.at + i) * (own - doubles<kLanes>(x + row.below[a] + i)) +
        doubles<kLanes>(w[a].data() + row.above[a] + i) *
            (own - doubles<kLanes>(x + row.above[a] + i));
  }
  return sum;
}

}  // namespace substep::gridfluid
