// What part of the room around each number of a staggered grid is liquid: of the cube of a cell
// that has a cell, a face or an edge (in 2D a corner) in its middle.
//
// All are means of the same 2^D parts of cells, so that cells, faces and edges have the same volume
// in all: Batty and Bridson, "Accurate viscous free surfaces for buckling, coiling, and rotating
// liquids", 2008, section 4, with the parts of a finer grid found from the distance in their
// middle.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "substep/core/aligned_buffer.h"
#include "substep/gridfluid/grid/layout.h"
#include "substep/gridfluid/pressure/obstacles.h"

namespace substep::gridfluid {

template <class Real, int D>
class Volumes {
 public:
  explicit Volumes(const Layout<D>& layout);

  // phi: of the liquid at the middle of cells, below 0 inside, in cells, with ghosts. Outside of
  // the box there is none.
  void find(const Obstacles<Real, D>& obstacles, std::span<const Real> phi, int threads);

  // Of cell i; of the face below it along an axis; of the edge below it along two.
  Real of_cell(std::int64_t i) const { return sum(0, i); }
  Real of_face(std::size_t a, std::int64_t i) const { return sum(1u << a, i); }
  Real of_edge(std::size_t a, std::size_t b, std::int64_t i) const {
    return sum(1u << a | 1u << b, i);
  }

 private:
  static constexpr unsigned kParts = 1u << D;
  // Bit a of the number of a part: whether it is in the upper half along axis a.
  using Parts = std::array<Real, kParts>;

  // Of a cube whose lower halves along some axes are in the cell below.
  Real sum(unsigned axes, std::int64_t i) const {
    Real sum = 0;
    for (unsigned part = 0; part < kParts; ++part)
      sum += parts_[usize(i - below_[part & axes])][part];
    return sum / kParts;
  }

  Layout<D> layout_;
  std::array<std::int64_t, kParts> below_;  // steps along a set of axes
  AlignedBuffer<Parts> parts_;
};

extern template class Volumes<float, 2>;
extern template class Volumes<float, 3>;
extern template class Volumes<double, 2>;
extern template class Volumes<double, 3>;

}  // namespace substep::gridfluid
