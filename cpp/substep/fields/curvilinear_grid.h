// A velocity field on a curvilinear grid (cells.h), in two dimensions, or in three with one more
// axis that is straight; with levels in time, between which it is linear. A node is four numbers:
// the velocity and, last, what is known there (0: nothing, land).
//
// On corners (Arakawa's A grid) the velocity is eastward and northward, or along x and y; it is
// bilinear in (xi, eta), with land as in grid.h.
//
// On faces (the C grid of ocean models; Delandmeter and van Sebille, "The Parcels v2.0 Lagrangian
// framework", Geosci. Model Dev. 12, 3571, 2019, section 2.1.3) u_i is the speed through the face
// between corners (i, j) and (i, j + 1), v_j through that between (i, j) and (i + 1, j), both along
// rising numbers. With the lengths L of the faces the flows U = u L and V = v L are linear across a
// cell of area J = |x_xi x x_eta|:
//   dxi/dt = [(1 - xi) U_i + xi U_i+1] / J,   deta/dt = [(1 - eta) V_j + eta V_j+1] / J.
// So flow that has no divergence in a cell goes along contours of its stream function, which is
// bilinear in (xi, eta), and none goes through a coast: a face on land lets nothing pass. The third
// velocity is on the faces of layers, and linear between them; u and v are those of the layer.
#pragma once

#include <span>
#include <vector>

#include "substep/core/lanes.h"
#include "substep/core/usize.h"
#include "substep/fields/cells.h"
#include "substep/fields/level.h"

namespace substep::fields {

template <class T, int kDim>
class CurvilinearGrid {
 public:
  using Scalar = T;
  static constexpr int kDimension = kDim;
  using V4 = Vector<T, 4 * sizeof(T)>;

  // z: of the corners, rising; radius [m]: x is longitude and y latitude [degrees]; 0: Cartesian.
  CurvilinearGrid(Corners corners, std::vector<double> z, Staggering staggering, double radius);

  // Level of values[i][j][k][component], NaN where missing; throws InputError on infinity.
  Level<T> pack(const double* values, int threads) const;
  std::int64_t node_count() const { return count_[0] * count_[1] * count_[2]; }

  // The cell in which a particle was found last.
  struct Hint {
    std::int64_t cell = -1;
  };
  // Velocity at x in slice's time [m/s]; dx/dt, for geographic coordinates in degrees/s.
  V4 velocity(const Slice<T>& slice, const V4& x, Place& place) const;
  V4 rate(const Slice<T>& slice, const V4& x, Place& place, Hint& hint) const;

  // Number of the block of cells that holds x, for sorting.
  std::int64_t block(const V4& x) const;
  std::int64_t block_count() const;

 private:
  struct Spot {
    Cells::Location cell;
    std::int64_t offset = 0, k = 0;  // of the low corner among the nodes, and of its layer
    double zeta = 0;
    Vec2 metres{1, 1};  // that a unit of x and of y is long there
  };
  using Numbers = std::array<double, 4>;

  bool find(const V4& x, Spot& spot, Hint& hint) const;
  Numbers node(const Slice<T>& slice, std::int64_t offset) const;
  Numbers on_corners(const Slice<T>& slice, const Spot& spot, Place& place) const;
  Numbers on_faces(const Slice<T>& slice, const Spot& spot, Place& place) const;
  // dx/dt of a spot.
  Numbers motion(const Slice<T>& slice, const V4& x, Place& place, Spot& spot, Hint& hint) const;

  Cells cells_;
  std::vector<double> z_;
  Staggering staggering_;
  double degree_;              // [m] of latitude; 0: Cartesian
  std::vector<Vec2> lengths_;  // of the faces from corner (i, j) to (i, j + 1) and (i + 1, j) [m]
  std::int64_t count_[3] = {1, 1, 1}, stride_[3] = {0, 0, 0};
};

extern template class CurvilinearGrid<double, 2>;
extern template class CurvilinearGrid<double, 3>;
extern template class CurvilinearGrid<float, 2>;
extern template class CurvilinearGrid<float, 3>;

}  // namespace substep::fields
