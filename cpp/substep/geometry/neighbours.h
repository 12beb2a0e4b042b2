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

#include <array>
#include <cstdint>
#include <memory>
#include <new>
#include <span>
#include <vector>

#include "substep/core/point.h"
#include "substep/core/radix_sort.h"
#include "substep/core/usize.h"

namespace substep::geometry {

// The neighbours of one point: `count` indices, and after them the index n (one behind the last
// point) up to a multiple of kPad. A kernel that takes whole vectors of lanes keeps a point far
// away at index n and need not mask. `indices` lies at a multiple of 64 bytes.
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
  // radii) from the origin, with its index; then nothing has changed.
  void sort(std::span<const Point<Real>> x, Real radius, int threads = 0);
  std::span<const std::int32_t> order() const { return order_; }

  // x: in cell order, as after the last sort(); the radius at most that of sort().
  void find(std::span<const Point<Real>> x, Real radius, Pairs pairs = Pairs::kFull,
            int threads = 0);
  NeighbourList operator[](std::int64_t i) const {
    const auto k = usize(i);
    return {lists_[k / kChunk].indices.get() + begin_[k], count_[k]};
  }
  std::int64_t size() const { return static_cast<std::int64_t>(order_.size()); }  // points
  std::int64_t pair_count() const { return pair_count_; }  // entries of all lists
  std::size_t bytes() const;                               // memory held

 private:
  static constexpr std::size_t kChunk = 2048;  // points whose lists lie in one piece of memory

  struct Aligned {
    void operator()(std::int32_t* p) const { ::operator delete[](p, std::align_val_t{64}); }
  };
  struct Lists {
    std::unique_ptr<std::int32_t[], Aligned> indices;
    std::size_t capacity = 0;
    void reserve(std::size_t used, std::size_t wanted);
  };
  // Points [begin, end): cells that lie beside each other in a row along x.
  struct Range {
    std::int32_t begin, end;
  };
  // Cell (a, b, c) has the key (a, b, c) . stride, modulo 2^64.
  struct Cells {
    Real radius = 0;
    double size = 0;
    std::array<std::int64_t, 3> lower{};
    std::array<std::uint64_t, 3> stride{};
    std::uint64_t table = 0;  // number of keys; 0: no table
    int bits = 64;            // of a key
  };
  class TableRows;
  class KeyRows;

  Cells lay_out(std::span<const Point<Real>> x, Real radius, int threads) const;
  std::vector<std::uint64_t> row_offsets() const;
  template <class Key>
  void sort_keys(std::span<const Point<Real>> x, RadixSort<Key>& radix_sort,
                 std::vector<KeyedIndex<Key>>& entries, int threads);
  void fill_table(int threads);
  void list_occupied_cells();
  template <class Rows>
  std::int64_t find_chunk(std::size_t chunk, Real radius_squared, Pairs pairs);

  int dimension_;
  Cells cells_;
  std::vector<std::int32_t> order_;
  // Either: the keys of the points, and where the points of each key begin.
  RadixSort<std::uint32_t> radix_sort_;
  std::vector<KeyedIndex<std::uint32_t>> entries_;
  std::vector<std::int32_t> table_;
  // Or: the sorted keys of the occupied cells, and where their points begin.
  RadixSort<std::uint64_t> wide_radix_sort_;
  std::vector<KeyedIndex<std::uint64_t>> wide_entries_;
  std::vector<std::uint64_t> occupied_;
  std::vector<std::int32_t> occupied_begin_;

  std::vector<Real> x_, y_, z_;  // by coordinate, for whole vectors
  std::vector<Lists> lists_;     // of each chunk
  std::vector<std::uint32_t> begin_;
  std::vector<std::int32_t> count_;
  std::int64_t pair_count_ = 0;
};

}  // namespace substep::geometry
