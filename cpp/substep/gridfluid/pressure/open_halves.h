// The open parts of the halves of a cell, of signed distances at its corners.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "substep/gridfluid/pressure/open_part.h"

namespace substep::gridfluid {

// Of the lower and the upper half along an axis, in cells, with the distances at the corners of the
// faces below and above; each pair of corners has a linear one between. Between the places t where
// one of these is 0 the open part of the section is a polynomial of second order if the surface is
// a plane, which two points of Gauss's integrate exactly.
template <class Real, std::size_t kCorners>
std::array<Real, 2> open_halves(const std::array<Real, kCorners>& below,
                                const std::array<Real, kCorners>& above) {
  std::array<Real, kCorners + 3> t{Real(0), Real(0.5), Real(1)};  // sorted
  std::size_t count = 3;
  for (std::size_t k = 0; k < kCorners; ++k) {
    if ((below[k] <= 0) == (above[k] <= 0)) continue;
    const Real zero = below[k] / (below[k] - above[k]);
    std::size_t place = count++;
    for (; place > 0 && t[place - 1] > zero; --place) t[place] = t[place - 1];
    t[place] = zero;
  }
  std::array<Real, 2> halves{};
  for (std::size_t k = 0; k + 1 < count; ++k) {
    const Real middle = (t[k] + t[k + 1]) / 2, wide = t[k + 1] - t[k];
    if (!(wide > 0)) continue;
    const Real off = wide / (2 * std::sqrt(Real(3)));
    for (const Real at : {middle - off, middle + off}) {
      std::array<Real, kCorners> here;
      for (std::size_t c = 0; c < kCorners; ++c) here[c] = below[c] + at * (above[c] - below[c]);
      halves[middle > Real(0.5)] += wide / 2 * open_part(here);
    }
  }
  return halves;
}

}  // namespace substep::gridfluid
