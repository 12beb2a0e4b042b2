// A velocity field on the nodes of a rectilinear grid, in two or three dimensions, with levels in
// time, which have one row of ghosts before and two after on every axis. A node is four numbers:
// the velocity and, last, 1 at sea and 0 where the value is missing (land); so one interpolation
// gives the sum of w_i u_i and the sum of w_i over the sea nodes.
//
// Space: (bi/tri)linear, or cubic convolution (Keys 1981, IEEE Trans. ASSP 29, 1153, eq. (15);
// Catmull-Rom), on unequal spacing the cubic Hermite polynomial with parabolic slopes, which is the
// same on equal spacing. Time: linear between levels.
// Missing values: a point is on land where its nearest node, of the level nearest in time, is
// missing; elsewhere the missing corners drop out and the weights of the others are scaled to sum
// to 1. A cell whose cubic stencil has a missing node is interpolated linearly.
#pragma once

#include <numbers>
#include <span>
#include <vector>

#include "substep/core/sincos.h"
#include "substep/core/usize.h"
#include "substep/fields/axis.h"
#include "substep/fields/level.h"

namespace substep::fields {

template <class T, int kDim>
class Grid {
 public:
  using Scalar = T;
  static constexpr int kDimension = kDim;
  using V4 = Vector<T, 4 * sizeof(T)>;
  using V8 = Vector<T, 8 * sizeof(T)>;

  // radius [m]: positions are (longitude, latitude [degrees], ...); 0: Cartesian.
  Grid(const std::vector<Axis>& axes, bool cubic, double radius);

  // Level of values[node][component], NaN where missing; throws InputError on infinity.
  Level<T> pack(const double* values, int threads) const;
  std::int64_t node_count() const;

  // Velocity at x in slice's time, in the units of the data.
  SUBSTEP_INLINE V4 velocity(const Slice<T>& slice, const V4& x, Place& place) const;

  // dx/dt: for geographic coordinates degrees/s,
  // dlon/dt = u / (R cos lat), dlat/dt = v / R.
  struct Hint {};  // a cell is found at once
  SUBSTEP_INLINE V4 rate(const Slice<T>& slice, const V4& x, Place& place, Hint&) const {
    const V4 u = velocity(slice, x, place);
    if (degrees_ == 0) return u;
    V4 sine, cosine;
    sincos_within_limit<V4>(x * (std::numbers::pi_v<T> / 180), sine, cosine);
    return u * V4{degrees_ / cosine[1], degrees_, 1, 1};
  }

  // Number of the block of 4^kDim cells that holds x, for sorting.
  std::int64_t block(const V4& x) const;
  std::int64_t block_count() const;

 private:
  using I4 = Vector<std::int32_t, 16>;
  struct Cell {
    V4 fraction;
    I4 index;             // along each axis
    std::int64_t offset;  // of its low corner among the nodes
    bool outside;
  };
  struct Spacing {  // parabolic slopes, see cubic_weights
    T a, b, c, e;
  };

  SUBSTEP_INLINE Cell locate(const V4& x) const;
  V4 unequal_coordinate(V4 x) const;
  SUBSTEP_INLINE V4 linear(const Level<T>& level, const Cell& cell) const;
  V4 cubic(const Level<T>& level, V4 fraction, I4 index, std::int64_t offset) const;
  void cubic_weights(int axis, T s, std::int32_t index, T w[4]) const;
  V4 among_land(const Slice<T>& slice, V4 fraction, std::int64_t offset, V4 sum) const;
  void fill_ghosts(int axis, std::vector<Node<T>>& nodes) const;
  void find_whole(Level<T>& level) const;

  std::int64_t count_[3] = {1, 1, 1}, padded_[3] = {1, 1, 1}, stride_[3] = {0, 0, 0};
  std::vector<T> edge_[3];           // cells + 1 coordinates
  std::vector<Spacing> spacing_[3];  // per cell
  T wrap_[3] = {0, 0, 0};
  bool closed_[3] = {false, false, false};
  bool uniform_ = true, wrapped_ = false, cubic_ = false;
  T degrees_ = 0;  // degrees of latitude per metre
  // Per lane, for equal spacing: cell = (x - origin) * inverse, reduced modulo turn cells.
  std::int64_t first_ = 0;  // offset of cell 0
  V4 origin_{}, inverse_{}, turn_{}, inverse_wrap_{}, low_{}, high_{};
  I4 last_{};
};

template <class T, int kDim>
SUBSTEP_INLINE auto Grid<T, kDim>::locate(const V4& x) const -> Cell {
  V4 q;  // in cells
  if (__builtin_expect(uniform_, 1)) {
    const V4 from_origin = x - origin_;
    q = from_origin * inverse_;
    if (wrapped_) q = fma<V4>(-turn_, floor<V4>(from_origin * inverse_wrap_), q);
  } else {
    q = unequal_coordinate(x);
  }
  const bool outside = !all_within<V4>(q, low_, high_);  // also where q is NaN
  q = q > 0 ? q : V4{};
  I4 index = __builtin_convertvector(q, I4);
  index = index < last_ ? index : last_;
  std::int64_t offset = first_;
  for (int d = 0; d < kDim; ++d) offset += index[d] * stride_[d];
  return {q - __builtin_convertvector(index, V4), index, offset, outside};
}

template <class T, int kDim>
SUBSTEP_INLINE auto Grid<T, kDim>::linear(const Level<T>& level, const Cell& cell) const -> V4 {
  // Two neighbours along the last axis are one load of eight numbers.
  const T* g = level.nodes[usize(cell.offset)].value;
  const auto pair = [&](std::int64_t node) -> V8 { return load<V8>(g + 4 * node); };
  const auto blend = [](const V8& s, const V8& from, const V8& to) {
    return fma<V8>(s, to - from, from);
  };
  const V4 s = cell.fraction;
  const V8 s0 = __builtin_shufflevector(s, s, 0, 0, 0, 0, 0, 0, 0, 0);
  const V8 s1 = __builtin_shufflevector(s, s, 1, 1, 1, 1, 1, 1, 1, 1);
  V8 row;
  if constexpr (kDim == 2) {
    row = blend(s0, pair(0), pair(stride_[0]));
  } else {
    const V8 near = blend(s1, pair(0), pair(stride_[1]));
    const V8 far = blend(s1, pair(stride_[0]), pair(stride_[0] + stride_[1]));
    row = blend(s0, near, far);
  }
  const V4 from = __builtin_shufflevector(row, row, 0, 1, 2, 3);
  const V4 to = __builtin_shufflevector(row, row, 4, 5, 6, 7);
  const V4 along = kDim == 2 ? V4(__builtin_shufflevector(s, s, 1, 1, 1, 1))
                             : V4(__builtin_shufflevector(s, s, 2, 2, 2, 2));
  return fma<V4>(along, to - from, from);
}

template <class T, int kDim>
SUBSTEP_INLINE auto Grid<T, kDim>::velocity(const Slice<T>& slice, const V4& x, Place& place) const
    -> V4 {
  const Cell cell = locate(x);
  if (__builtin_expect(cell.outside, 0)) {
    if (place == Place::kSea) place = Place::kOutside;
    return V4{};
  }
  if (cubic_) {
    const auto at = usize(cell.offset);
    if (slice.low->whole[at] && (!slice.high || slice.high->whole[at])) {
      const auto at_level = [&](const Level<T>& level) {
        return cubic(level, cell.fraction, cell.index, cell.offset);
      };
      const V4 u = at_level(*slice.low);
      return slice.high ? fma<V4>(slice.weight, at_level(*slice.high) - u, u) : u;
    }
  }
  V4 u = linear(*slice.low, cell);
  if (slice.high) u = fma<V4>(slice.weight, linear(*slice.high, cell) - u, u);
  if (__builtin_expect(u[3] == 1, 1)) return u;
  u = among_land(slice, cell.fraction, cell.offset, u);
  if (u[3] == 0 && place == Place::kSea) place = Place::kLand;
  return u;
}

extern template class Grid<double, 2>;
extern template class Grid<double, 3>;
extern template class Grid<float, 2>;
extern template class Grid<float, 3>;

}  // namespace substep::fields
