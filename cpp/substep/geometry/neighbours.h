// Who is near whom: points sorted by cell, and the lists of those closer than a radius.
//
// A search has two halves, so that its owner keeps all of his arrays in cell order:
//   sort(x, radius)   order()[k] is the index of the point that comes k-th; points of one cell keep
//                     the order they came in. The owner permutes his arrays by it.
//   find(x, radius)   of points in cell order: for each i the j with |x_i - x_j| < radius,
//   ascending.
// There are no bounds to a domain: space is a table of cells while that is small beside the points,
// and sorted keys of occupied cells otherwise. Exact also for coincident points.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/point.h"

namespace substep::geometry {

// The neighbours of one point: `count` indices, and after them the index n (one behind the last
// point) up to a multiple of kPad. A kernel that takes whole vectors of lanes keeps a point far
// away at index n and need not mask.
struct NeighbourList {
  static constexpr int kPad = 16;
  const std::int32_t* indices;
  std::int32_t count;

  std::int32_t padded() const { return (count + kPad - 1) / kPad * kPad; }
};

enum class Pairs { kFull, kHalf };  // half: j > i only

template <class Real>
class Neighbours {
 public:
  // 3, or 2 where all z are equal.
  explicit Neighbours(int dimension = 3);

  // Throws InputError where a coordinate is not finite or beyond the integers of Real (2^24 or 2^53
  // radii) from the origin, with its index.
  void sort(std::span<const Point<Real>> x, Real radius, int threads = 0);
  std::span<const std::int32_t> order() const { return order_; }

  // x: in cell order, as after the last sort(); the radius at most that of sort().
  void find(std::span<const Point<Real>> x, Real radius, Pairs pairs = Pairs::kFull,
            int threads = 0);
  NeighbourList operator[](std::int64_t i) const;
  std::int64_t size() const;        // points
  std::int64_t pair_count() const;  // entries of all lists

 private:
  std::vector<std::int32_t> order_;
};

}  // namespace substep::geometry
