#include "substep/geometry/neighbours.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <new>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/candidates.h"

namespace substep::geometry {
namespace {

constexpr std::int64_t kGrain = 16384;  // points per task of the simple loops

// Two points that count as closer than the radius after rounding are less than a cell apart, also
// after the rounding of their cells' coordinates, which is below 2^-21 cells.
constexpr double kMargin = 0x1p-20;

// The cell of a coordinate along one axis.
template <class Real>
std::int64_t cell_of(Real x, double cell_size, double inverse) {
  const double q = static_cast<double>(x) * inverse;
  if constexpr (std::is_same_v<Real, double>) {
    if (std::abs(q) >= 0x1p30) {
      const long double exact = static_cast<long double>(x) / static_cast<long double>(cell_size);
      return static_cast<std::int64_t>(std::floor(exact));
    }
  }
  return static_cast<std::int64_t>(std::floor(q));
}

template <class Real>
struct Bounds {
  std::array<Real, 3> low, high;
};

template <class Real>
[[noreturn]] void refuse(std::span<const Point<Real>> x, Real limit) {
  const auto inside = [=](const Point<Real>& p) {
    return std::abs(p.x) <= limit && std::abs(p.y) <= limit && std::abs(p.z) <= limit;
  };
  const auto i = std::find_if_not(x.begin(), x.end(), inside) - x.begin();
  const Point<Real>& p = x[usize(i)];
  throw InputError("points[" + std::to_string(i) + "]: expected finite coordinates within " +
                   std::to_string(std::numeric_limits<Real>::digits) +
                   " bits of the radius, at most " + std::to_string(limit) + ", got (" +
                   std::to_string(p.x) + ", " + std::to_string(p.y) + ", " + std::to_string(p.z) +
                   ")");
}

// The box about the points. Throws InputError where a coordinate is not finite or too far.
template <class Real>
Bounds<Real> bounding_box(std::span<const Point<Real>> x, Real radius, int threads) {
  const Real limit = std::min(std::ldexp(radius, std::numeric_limits<Real>::digits),
                              std::numeric_limits<Real>::max());
  const auto n = static_cast<std::int64_t>(x.size());
  std::vector<Bounds<Real>> parts(usize((n + kGrain - 1) / kGrain));
  std::vector<char> bad(parts.size());
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        constexpr Real kInfinity = std::numeric_limits<Real>::infinity();
        std::array<Real, 4> low, high;
        low.fill(kInfinity);
        high.fill(-kInfinity);
        bool outside = false;
        for (std::int64_t i = begin; i < end; ++i) {
          const Point<Real>& p = x[usize(i)];
          const std::array<Real, 4> row{p.x, p.y, p.z, Real{0}};
          for (std::size_t a = 0; a < 4; ++a) {
            low[a] = row[a] < low[a] ? row[a] : low[a];
            high[a] = row[a] > high[a] ? row[a] : high[a];
            outside |= !(std::abs(row[a]) <= limit);
          }
        }
        const auto part = usize(begin / kGrain);
        parts[part] = {{low[0], low[1], low[2]}, {high[0], high[1], high[2]}};
        bad[part] = outside;
      },
      threads);
  if (std::find(bad.begin(), bad.end(), 1) != bad.end()) refuse(x, limit);
  Bounds<Real> box = parts[0];
  for (const Bounds<Real>& part : parts) {
    for (std::size_t a = 0; a < 3; ++a) {
      box.low[a] = std::min(box.low[a], part.low[a]);
      box.high[a] = std::max(box.high[a], part.high[a]);
    }
  }
  return box;
}

template <class T>
std::size_t held(const std::vector<T>& v) {
  return v.capacity() * sizeof(T);
}

}  // namespace

// Where the points of a cell's neighbours lie, by the table of all cells.
template <class Real>
class Neighbours<Real>::TableRows {
 public:
  TableRows(const Neighbours& owner, std::int32_t) : owner_(owner), offsets_(owner.row_offsets()) {}

  // The end of the cell of point k; the ranges of points about it, in rising order.
  std::int32_t next(std::int32_t k, std::vector<Range>& ranges) {
    const std::int64_t key = owner_.entries_[usize(k)].key;
    const std::int32_t* const begin = owner_.table_.data() + key;
    ranges.clear();
    for (const std::uint64_t offset : offsets_) {
      const std::int32_t* const row = begin + static_cast<std::int64_t>(offset);
      ranges.push_back({row[-1], row[2]});
    }
    return begin[1];
  }

 private:
  const Neighbours& owner_;
  std::vector<std::uint64_t> offsets_;
};

// The same by the sorted keys of the occupied cells: for each row about the cell a cursor that
// follows as the cell moves on.
template <class Real>
class Neighbours<Real>::KeyRows {
 public:
  KeyRows(const Neighbours& owner, std::int32_t k)
      : keys_(owner.occupied_), begin_(owner.occupied_begin_), offsets_(owner.row_offsets()) {
    cell_ = std::upper_bound(begin_.begin(), begin_.end(), k) - begin_.begin() - 1;
    cursors_.assign(offsets_.size(), {0, keys_.size()});
  }

  std::int32_t next(std::int32_t, std::vector<Range>& ranges) {
    ranges.clear();
    const auto cell = usize(cell_++);
    for (std::size_t r = 0; r < offsets_.size(); ++r) {
      Cursor& cursor = cursors_[r];
      const std::uint64_t first = keys_[cell] + offsets_[r] - 1;
      if (first < cursor.key || cursor.cell == keys_.size()) {
        cursor.cell = usize(std::lower_bound(keys_.begin(), keys_.end(), first) - keys_.begin());
      }
      cursor.key = first;
      while (cursor.cell < keys_.size() && keys_[cursor.cell] < first) ++cursor.cell;
      add(cursor.cell, first, ranges);
      if (first + 2 < first) add(0, first, ranges);  // keys are numbers modulo 2^64
    }
    std::sort(ranges.begin(), ranges.end(),
              [](const Range& a, const Range& b) { return a.begin < b.begin; });
    return begin_[cell + 1];
  }

 private:
  struct Cursor {
    std::uint64_t key;
    std::size_t cell;
  };

  // The cells from `from` on whose keys are first, first + 1 or first + 2.
  void add(std::size_t from, std::uint64_t first, std::vector<Range>& ranges) const {
    std::size_t to = from;
    while (to < keys_.size() && keys_[to] - first <= 2) ++to;
    if (to > from) ranges.push_back({begin_[from], begin_[to]});
  }

  const std::vector<std::uint64_t>& keys_;
  const std::vector<std::int32_t>& begin_;
  std::vector<std::uint64_t> offsets_;
  std::vector<Cursor> cursors_;
  std::ptrdiff_t cell_;
};

template <class Real>
Neighbours<Real>::Neighbours(int dimension) : dimension_(dimension) {
  if (dimension != 2 && dimension != 3) throw InputError("dimension: expected 2 or 3");
}

template <class Real>
void Neighbours<Real>::sort(std::span<const Point<Real>> x, Real radius, int threads) {
  if (!(radius > 0) || !std::isnormal(radius * radius)) {
    throw InputError("radius: expected a number above 0 whose square is representable, got " +
                     std::to_string(radius));
  }
  if (x.size() > std::numeric_limits<std::int32_t>::max() - 64) {
    throw InputError("points: expected fewer than 2^31 - 64 rows");
  }
  cells_ = lay_out(x, radius, threads);
  order_.resize(x.size());
  if (cells_.table) {
    sort_keys(x, radix_sort_, entries_, threads);
    fill_table(threads);
  } else {
    sort_keys(x, wide_radix_sort_, wide_entries_, threads);
    list_occupied_cells();
  }
}

// One empty cell lies about the box, so that the cells about an occupied one always have keys.
// Where the keys would exceed 64 bits, cells may share one: that adds candidates, and loses none.
template <class Real>
typename Neighbours<Real>::Cells Neighbours<Real>::lay_out(std::span<const Point<Real>> x,
                                                           Real radius, int threads) const {
  Cells cells;
  cells.radius = radius;
  cells.size = static_cast<double>(radius) * (1 + kMargin);
  if (x.empty()) return cells;
  const Bounds<Real> box = bounding_box(x, radius, threads);
  std::array<std::uint64_t, 3> extent{1, 1, 1};
  double count = 1;
  for (std::size_t a = 0; a < usize(dimension_); ++a) {
    cells.lower[a] = cell_of(box.low[a], cells.size, 1 / cells.size) - 1;
    const std::int64_t upper = cell_of(box.high[a], cells.size, 1 / cells.size) + 1;
    extent[a] = static_cast<std::uint64_t>(upper - cells.lower[a] + 1);
    count *= static_cast<double>(extent[a]);
  }
  cells.stride = {1, std::uint64_t{1} << 21, std::uint64_t{1} << 42};
  if (count < 0x1p63) {
    cells.stride = {1, extent[0], extent[0] * extent[1]};
    cells.bits = std::bit_width(extent[0] * extent[1] * extent[2]);
  }
  if (dimension_ == 2) cells.stride[2] = 0;
  if (count <= std::min(std::max(8.0 * static_cast<double>(x.size()), 0x1p16), 0x1p31)) {
    cells.table = extent[0] * extent[1] * extent[2];
  }
  return cells;
}

// Row by row: x fastest, then y, then z.
template <class Real>
std::vector<std::uint64_t> Neighbours<Real>::row_offsets() const {
  std::vector<std::uint64_t> offsets;
  const int depth = dimension_ == 3 ? 1 : 0;
  for (int c = -depth; c <= depth; ++c) {
    for (int b = -1; b <= 1; ++b) {
      offsets.push_back(static_cast<std::uint64_t>(c) * cells_.stride[2] +
                        static_cast<std::uint64_t>(b) * cells_.stride[1]);
    }
  }
  return offsets;
}

template <class Real>
template <class Key>
void Neighbours<Real>::sort_keys(std::span<const Point<Real>> x, RadixSort<Key>& radix_sort,
                                 std::vector<KeyedIndex<Key>>& entries, int threads) {
  const auto n = static_cast<std::int64_t>(x.size());
  entries.resize(x.size());
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        const Cells cells = cells_;
        const double inverse = 1 / cells.size;
        const auto part = [&](Real coordinate, std::size_t a) {
          const std::int64_t cell = cell_of(coordinate, cells.size, inverse) - cells.lower[a];
          return static_cast<std::uint64_t>(cell) * cells.stride[a];
        };
        for (std::int64_t i = begin; i < end; ++i) {
          const Point<Real>& p = x[usize(i)];
          const std::uint64_t key = part(p.x, 0) + part(p.y, 1) + part(p.z, 2);
          entries[usize(i)] = {static_cast<Key>(key), static_cast<std::int32_t>(i)};
        }
      },
      threads);
  radix_sort(entries, cells_.bits, threads);
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          order_[usize(k)] = entries[usize(k)].index;
        }
      },
      threads);
}

// table_[key] is the first point whose key is not below.
template <class Real>
void Neighbours<Real>::fill_table(int threads) {
  const auto n = static_cast<std::int64_t>(entries_.size());
  table_.resize(cells_.table + 2);
  parallel_for(
      n, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const auto at = usize(k);
          const std::int64_t before = k ? std::int64_t{entries_[at - 1].key} : -1;
          for (std::int64_t key = before + 1; key <= entries_[at].key; ++key) {
            table_[usize(key)] = static_cast<std::int32_t>(k);
          }
        }
      },
      threads);
  std::fill(table_.begin() + entries_.back().key + 1, table_.end(), static_cast<std::int32_t>(n));
}

template <class Real>
void Neighbours<Real>::list_occupied_cells() {
  occupied_.clear();
  occupied_begin_.clear();
  for (std::size_t k = 0; k < wide_entries_.size(); ++k) {
    if (k == 0 || wide_entries_[k].key != wide_entries_[k - 1].key) {
      occupied_.push_back(wide_entries_[k].key);
      occupied_begin_.push_back(static_cast<std::int32_t>(k));
    }
  }
  occupied_begin_.push_back(static_cast<std::int32_t>(wide_entries_.size()));
}

template <class Real>
void Neighbours<Real>::Lists::reserve(std::size_t used, std::size_t wanted) {
  void* const memory = ::operator new[](wanted * sizeof(std::int32_t), std::align_val_t{64});
  std::unique_ptr<std::int32_t[], Aligned> grown(static_cast<std::int32_t*>(memory));
  std::copy_n(indices.get(), used, grown.get());
  indices = std::move(grown);
  capacity = wanted;
}

template <class Real>
void Neighbours<Real>::find(std::span<const Point<Real>> x, Real radius, Pairs pairs, int threads) {
  if (x.size() != order_.size()) throw InputError("points: expected as many as were sorted");
  if (!(radius > 0) || radius > cells_.radius) {
    throw InputError("radius: expected a number above 0 and at most that of sort()");
  }
  const std::size_t n = x.size();
  for (auto* const coordinate : {&x_, &y_, &z_}) coordinate->resize(n + Candidates<Real>::kBlock);
  begin_.resize(n);
  count_.resize(n);
  const std::size_t chunks = (n + kChunk - 1) / kChunk;
  lists_.resize(chunks);
  std::vector<std::int64_t> pair_counts(chunks);
  parallel_for(
      static_cast<std::int64_t>(n), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (auto k = usize(begin); k < usize(end); ++k) {
          x_[k] = x[k].x;
          y_[k] = x[k].y;
          z_[k] = x[k].z;
        }
      },
      threads);
  parallel_chunks(
      static_cast<std::int64_t>(chunks),
      [&](std::int64_t chunk) {
        const auto c = usize(chunk);
        pair_counts[c] = cells_.table ? find_chunk<TableRows>(c, radius * radius, pairs)
                                      : find_chunk<KeyRows>(c, radius * radius, pairs);
      },
      threads);
  pair_count_ = 0;
  for (const std::int64_t count : pair_counts) pair_count_ += count;
}

template <class Real>
template <class Rows>
std::int64_t Neighbours<Real>::find_chunk(std::size_t chunk, Real radius_squared, Pairs pairs) {
  constexpr std::size_t kPad = NeighbourList::kPad;
  constexpr std::size_t kFew = 64;  // points that let the memory of a chunk be estimated
  const std::size_t first = chunk * kChunk, last = std::min(first + kChunk, order_.size());
  const auto none = static_cast<std::int32_t>(order_.size());
  Lists& lists = lists_[chunk];
  Rows rows(*this, static_cast<std::int32_t>(first));
  std::vector<Range> ranges;
  Candidates<Real> candidates(x_.data(), y_.data(), z_.data());
  std::size_t used = 0;
  std::int64_t total = 0;
  for (std::size_t k = first; k < last;) {
    const auto cell = static_cast<std::int32_t>(k);
    const std::size_t stop = std::min(last, usize(rows.next(cell, ranges)));
    candidates.clear();
    for (const Range& range : ranges) {
      candidates.add(pairs == Pairs::kHalf ? std::max(range.begin, cell) : range.begin, range.end);
    }
    candidates.close();
    const std::size_t most = usize(candidates.size()) + 2 * kPad;
    for (std::size_t i = k; i < stop; ++i) {
      if (used + most > lists.capacity) {
        const std::size_t done = i - first;
        const std::size_t left = done < kFew ? kFew * most : used * (last - i) / done;
        lists.reserve(used, used + most + left + left / 16);
      }
      std::int32_t* const out = lists.indices.get() + used;
      const Real p[3] = {x_[i], y_[i], z_[i]};
      const auto self = static_cast<std::int32_t>(i);
      const int from = static_cast<int>((i - k) / kPad * kPad);
      std::int32_t* const end =
          pairs == Pairs::kHalf
              ? candidates.template append_near<Pairs::kHalf>(p, self, from, radius_squared, out)
              : candidates.template append_near<Pairs::kFull>(p, self, 0, radius_squared, out);
      std::fill_n(end, kPad, none);
      begin_[i] = static_cast<std::uint32_t>(used);
      count_[i] = static_cast<std::int32_t>(end - out);
      total += end - out;
      used += (usize(end - out) + kPad - 1) / kPad * kPad;
      if (used > std::numeric_limits<std::uint32_t>::max()) throw std::bad_alloc();
    }
    k = stop;
  }
  if (lists.capacity > 2 * used + 4 * kChunk) lists.reserve(used, used + used / 16);
  return total;
}

template <class Real>
std::size_t Neighbours<Real>::bytes() const {
  std::size_t sum = held(order_) + radix_sort_.bytes() + held(entries_) + held(table_) +
                    wide_radix_sort_.bytes() + held(wide_entries_) + held(occupied_) +
                    held(occupied_begin_) + held(x_) + held(y_) + held(z_) + held(lists_) +
                    held(begin_) + held(count_);
  for (const Lists& lists : lists_) sum += lists.capacity * sizeof(std::int32_t);
  return sum;
}

template class Neighbours<float>;
template class Neighbours<double>;

}  // namespace substep::geometry
