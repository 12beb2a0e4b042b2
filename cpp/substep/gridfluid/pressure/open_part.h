// The open part of a face, of signed distances at its corners.
#pragma once

#include <array>
#include <cstddef>

namespace substep::gridfluid {

// The part above 0 of an edge that ends in a <= 0 < b.
template <class Real>
Real above(Real a, Real b) {
  return b / (b - a);
}

// The part of a face where the distance, linear along its edges, is above 0.
template <class Real>
Real open_part(const std::array<Real, 2>& d) {
  const bool in0 = d[0] <= 0, in1 = d[1] <= 0;
  if (in0 != in1) return in0 ? above(d[0], d[1]) : above(d[1], d[0]);
  return Real(in0 ? 0 : 1);
}
// Of a square with corners in a circle.
template <class Real>
Real open_part(const std::array<Real, 4>& d) {
  const auto in = [&](std::size_t k) { return d[k % 4] <= 0; };
  const auto part = [&](std::size_t from, std::size_t to) { return above(d[from % 4], d[to % 4]); };
  const auto solid_corner = [&](std::size_t k) {  // a triangle
    return (1 - part(k, k + 1)) * (1 - part(k, k + 3)) / 2;
  };
  const auto open_corner = [&](std::size_t k) { return part(k + 1, k) * part(k + 3, k) / 2; };
  const int solid = in(0) + in(1) + in(2) + in(3);
  if (solid == 0) return 1;
  if (solid == 4) return 0;
  std::size_t k = 0;
  if (solid == 1) {
    while (!in(k)) ++k;
    return 1 - solid_corner(k);
  }
  if (solid == 3) {
    while (in(k)) ++k;
    return open_corner(k);
  }
  while (!in(k)) ++k;
  if (in(k + 2)) {  // two opposite corners: joined by what the middle is
    return d[0] + d[1] + d[2] + d[3] > 0 ? 1 - solid_corner(k) - solid_corner(k + 2)
                                         : open_corner(k + 1) + open_corner(k + 3);
  }
  if (!in(k + 1)) k += 3;  // now k and k + 1 are solid
  return (part(k, k + 3) + part(k + 1, k + 2)) / 2;
}

}  // namespace substep::gridfluid
