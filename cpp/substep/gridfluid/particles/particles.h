// The particles of a liquid on a grid, in the order of its cells.
//
// One array for each number of a particle. After sort() the particles of cell i of the layout are
// those from first()[i] to first()[i + 1]: what passes between particles and grid runs over rows
// of cells, whose particles follow each other.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/radix_sort.h"
#include "substep/core/usize.h"
#include "substep/gridfluid/grid/layout.h"

namespace substep::gridfluid {

template <class Real, int D>
class Particles {
 public:
  // With C where the particles are to be affine (APIC).
  explicit Particles(bool affine) : affine_(affine) {}

  std::int64_t size() const { return size_; }
  bool affine() const { return affine_; }

  // Arrays of size() numbers, and kPadding more that kernels may read and overwrite.
  static constexpr std::int64_t kPadding = 16;
  Real* x(int d) { return now_.numbers[usize(d)].data(); }      // [cells] from the low corner
  Real* v(int d) { return now_.numbers[usize(D + d)].data(); }  // [m/s]
  Real* C(int c, int d) { return now_.numbers[usize((2 + c) * D + d)].data(); }  // dv_c/dx_d [1/s]
  std::int64_t* id() { return now_.id.data(); }
  const Real* x(int d) const { return now_.numbers[usize(d)].data(); }
  const Real* v(int d) const { return now_.numbers[usize(D + d)].data(); }
  const Real* C(int c, int d) const { return now_.numbers[usize((2 + c) * D + d)].data(); }
  const std::int64_t* id() const { return now_.id.data(); }

  // Puts n particles behind the others: rows of D numbers of x and v, of D * D of C (null: 0).
  // Where this throws, nothing has changed.
  void append(std::int64_t n, const Real* x, const Real* v, const Real* C, const std::int64_t* id);

  void append(const Particles& others);  // affine, or not, as these

  // Drops the particles whose flag is set; the others keep their order.
  void erase(std::span<const std::uint8_t> flags, int threads);

  // Gives back memory where most of it is unused.
  void shrink();

  // Orders the particles by cell; those of a cell keep their order. A particle outside of the box
  // counts as in the nearest cell. Where this throws, nothing has changed.
  void sort(const Layout<D>& layout, int threads);
  // Becomes others, sorted, which stay as they are.
  void take_sorted(const Particles& others, const Layout<D>& layout, int threads);

  // By cell of the layout of the last sort(), and one more at the end. Holds until the next
  // append() or erase().
  const std::int32_t* first() const { return first_.data(); }

  std::size_t bytes() const;

 private:
  struct Arrays {
    std::array<AlignedBuffer<Real>, usize((2 + D) * D)> numbers;  // x, v, C
    AlignedBuffer<std::int64_t> id;
  };
  int fields() const { return affine_ ? (2 + D) * D : 2 * D; }
  void reserve(Arrays& arrays, std::int64_t n) const;
  void make_room(std::int64_t more);
  bool prepare_sort(const Layout<D>& layout, const Arrays& from, int threads);
  void move_sorted(bool in_order, const Arrays& from, Arrays& to, int threads);
  bool find_cells(const Layout<D>& layout, const Arrays& from, int threads);
  void count_to_places();
  void sort_bucket(std::int64_t bucket, bool in_order, const Arrays& from, Arrays& to);

  bool affine_;
  std::int64_t size_ = 0, capacity_ = 0;
  Arrays now_, next_;  // sort() moves the particles from one to the other
  AlignedBuffer<std::int32_t> first_;

  // Of sort(). Buckets are ranges of 2^bucket_bits_ cells of the layout.
  int bucket_bits_ = 0;
  std::int64_t buckets_ = 0, chunk_ = 0, cells_of_layout_ = 0;
  AlignedBuffer<std::int32_t> cell_;                 // of each particle
  AlignedBuffer<KeyedIndex<std::int32_t>> entries_;  // (cell, particle) by bucket
  AlignedBuffer<std::int32_t> source_;               // where each particle comes from
  std::vector<std::int32_t> places_;                 // of each chunk of particles and bucket
  std::vector<std::int32_t> bucket_first_;
};

}  // namespace substep::gridfluid
