#include "substep/gridfluid/particles/particles.h"

#include <algorithm>

#include "substep/core/parallel.h"

namespace substep::gridfluid {
namespace {

constexpr int kMaxBuckets = 1024;          // their counters stay in the L1 cache
constexpr std::int64_t kMinChunk = 16384;  // particles
constexpr std::int64_t kMaxChunks = 256;   // bounds the memory of the counters
constexpr std::int64_t kBucketsOfTask = 4;

template <class T>
void grow(AlignedBuffer<T>& buffer, std::int64_t n, std::int64_t kept) {
  AlignedBuffer<T> larger;
  larger.reset(usize(n));
  if (kept > 0) std::copy_n(buffer.data(), kept, larger.data());
  buffer = std::move(larger);
}

// to[i] = from[source[i]]. (The empty statement keeps the compiler from putting together vectors of
// single loads, which takes longer than the loads.)
template <class T>
void take(const T* __restrict from, const std::int32_t* __restrict source, std::int64_t n,
          T* __restrict to) {
  for (std::int64_t i = 0; i < n; ++i) {
    std::int64_t at = source[i];
    asm("" : "+r"(at));
    to[i] = from[at];
  }
}

}  // namespace

template <class Real, int D>
void Particles<Real, D>::reserve(Arrays& arrays, std::int64_t n) const {
  for (std::size_t f = 0; f < usize(fields()); ++f) {
    if (static_cast<std::int64_t>(arrays.numbers[f].size()) < n) {
      grow(arrays.numbers[f], n, &arrays == &now_ ? size_ : 0);
    }
  }
  if (static_cast<std::int64_t>(arrays.id.size()) < n) {
    grow(arrays.id, n, &arrays == &now_ ? size_ : 0);
  }
}

template <class Real, int D>
void Particles<Real, D>::append(std::int64_t n, const Real* x, const Real* v, const Real* C,
                                const std::int64_t* id) {
  make_room(n);
  const auto put = [&](const Real* rows, int field, int width) {
    for (int k = 0; k < width; ++k) {
      Real* const to = now_.numbers[usize(field + k)].data() + size_;
      for (std::int64_t i = 0; i < n; ++i) to[i] = rows != nullptr ? rows[i * width + k] : Real(0);
    }
  };
  put(x, 0, D);
  put(v, D, D);
  if (affine_) put(C, 2 * D, D * D);
  std::copy_n(id, n, now_.id.data() + size_);
  size_ += n;
}

template <class Real, int D>
void Particles<Real, D>::append(const Particles& others) {
  make_room(others.size_);
  for (std::size_t f = 0; f < usize(fields()); ++f) {
    std::copy_n(others.now_.numbers[f].data(), others.size_, now_.numbers[f].data() + size_);
  }
  std::copy_n(others.id(), others.size_, id() + size_);
  size_ += others.size_;
}

template <class Real, int D>
void Particles<Real, D>::make_room(std::int64_t more) {
  if (size_ + more <= capacity_) return;
  const std::int64_t room = std::max(size_ + more, capacity_ + capacity_ / 2);
  reserve(now_, room + kPadding);
  capacity_ = room;
}

template <class Real, int D>
void Particles<Real, D>::erase(std::span<const std::uint8_t> flags, int threads) {
  const auto keep = [&](auto* array) {
    std::int64_t kept = 0;
    for (std::int64_t i = 0; i < size_; ++i) {
      if (flags[usize(i)] == 0) array[kept++] = array[i];
    }
    return kept;
  };
  std::int64_t kept = 0;
  parallel_chunks(
      fields() + 1,
      [&](std::int64_t f) {
        if (f < fields()) {
          keep(now_.numbers[usize(f)].data());
        } else {
          kept = keep(now_.id.data());
        }
      },
      threads);
  size_ = kept;
}

template <class Real, int D>
void Particles<Real, D>::shrink() {
  if (size_ >= static_cast<std::int64_t>(now_.id.size()) / 4) return;
  Particles smaller(affine_);
  smaller.append(*this);
  std::swap(*this, smaller);
}

// Sets cell_ and counts the particles of each chunk in each bucket. Returns whether the particles
// are in order as they are.
template <class Real, int D>
bool Particles<Real, D>::find_cells(const Layout<D>& layout, const Arrays& from, int threads) {
  const std::int64_t chunks = (size_ + chunk_ - 1) / chunk_;
  places_.assign(usize(chunks * buckets_), 0);
  std::vector<std::uint8_t> in_order(usize(chunks));
  std::array<Real, D> last;
  std::array<std::int32_t, D> stride;
  for (std::size_t d = 0; d < D; ++d) {
    last[d] = static_cast<Real>(layout.cells[d] - 1);
    stride[d] = static_cast<std::int32_t>(layout.stride[d]);
  }
  const auto first = static_cast<std::int32_t>(layout.first);
  parallel_for(
      size_, chunk_,
      [&](std::int64_t begin, std::int64_t end) {
        std::int32_t* const __restrict cell = cell_.data();
        for (std::int64_t i = begin; i < end; ++i) cell[i] = first;
        for (std::size_t d = 0; d < D; ++d) {
          const Real* const __restrict x = from.numbers[d].data();
          const std::int32_t step = stride[d];
          const Real high = last[d];
          for (std::int64_t i = begin; i < end; ++i) {
            const Real above = x[i] > 0 ? x[i] : Real(0);  // also where x is NaN
            cell[i] += static_cast<std::int32_t>(above < high ? above : high) * step;
          }
        }
        std::int32_t* const count = places_.data() + begin / chunk_ * buckets_;
        for (std::int64_t i = begin; i < end; ++i) ++count[cell[i] >> bucket_bits_];
        in_order[usize(begin / chunk_)] = std::is_sorted(cell + begin, cell + end);
      },
      threads);
  for (std::int64_t c = 1; c < chunks; ++c) {
    in_order[0] &= in_order[usize(c)] & (cell_[usize(c * chunk_ - 1)] <= cell_[usize(c * chunk_)]);
  }
  return chunks == 0 || in_order[0] != 0;
}

// From numbers of particles to where the first of each bucket and chunk goes.
template <class Real, int D>
void Particles<Real, D>::count_to_places() {
  const std::size_t chunks = buckets_ == 0 ? 0 : places_.size() / usize(buckets_);
  bucket_first_.assign(usize(buckets_ + 1), 0);
  for (std::size_t c = 0; c < chunks; ++c) {
    for (std::size_t b = 0; b < usize(buckets_); ++b) {
      std::int32_t& sum = bucket_first_[b + 1];
      const std::int32_t count = places_[c * usize(buckets_) + b];
      places_[c * usize(buckets_) + b] = sum;  // so far only within the bucket
      sum += count;
    }
  }
  for (std::size_t b = 0; b < usize(buckets_); ++b) bucket_first_[b + 1] += bucket_first_[b];
}

// Orders the entries of a bucket by cell and moves its particles.
template <class Real, int D>
void Particles<Real, D>::sort_bucket(std::int64_t bucket, bool in_order, const Arrays& from,
                                     Arrays& to) {
  const std::int64_t cell0 = bucket << bucket_bits_;
  const std::int64_t cells =
      std::min(std::int64_t{1} << bucket_bits_, cells_of_layout_ + 1 - cell0);
  const std::int32_t begin = bucket_first_[usize(bucket)], end = bucket_first_[usize(bucket + 1)];
  std::int32_t* const first = first_.data() + cell0;
  std::fill_n(first, cells, begin == end ? begin : 0);
  if (begin == end) return;

  const auto cell_of = [&](std::int32_t i) {
    return (in_order ? cell_[usize(i)] : entries_[usize(i)].key) - cell0;
  };
  for (std::int32_t i = begin; i < end; ++i) ++first[cell_of(i)];
  std::int32_t place = begin;
  for (std::int64_t c = 0; c < cells; ++c) place += std::exchange(first[c], place);
  const std::int64_t count = end - begin;
  if (in_order) {
    if (&from == &to) return;
    for (std::size_t f = 0; f < usize(fields()); ++f) {
      std::copy_n(from.numbers[f].data() + begin, count, to.numbers[f].data() + begin);
    }
    std::copy_n(from.id.data() + begin, count, to.id.data() + begin);
    return;
  }

  std::int32_t* const __restrict source = source_.data();
  for (std::int32_t i = begin; i < end; ++i) {
    source[first[cell_of(i)]++] = entries_[usize(i)].index;
  }
  for (std::int64_t c = cells - 1; c > 0; --c) first[c] = first[c - 1];  // as before the loop
  first[0] = begin;
  for (std::size_t f = 0; f < usize(fields()); ++f) {
    take(from.numbers[f].data(), source + begin, count, to.numbers[f].data() + begin);
  }
  take(from.id.data(), source + begin, count, to.id.data() + begin);
}

template <class Real, int D>
void Particles<Real, D>::sort(const Layout<D>& layout, int threads) {
  if (!prepare_sort(layout, now_, threads)) {
    reserve(next_, capacity_ + kPadding);
    move_sorted(false, now_, next_, threads);
    std::swap(now_, next_);
  } else {
    move_sorted(true, now_, now_, threads);
  }
}

template <class Real, int D>
void Particles<Real, D>::take_sorted(const Particles& others, const Layout<D>& layout,
                                     int threads) {
  size_ = 0;  // nothing of before is kept
  reserve(now_, others.capacity_ + kPadding);
  size_ = others.size_;
  capacity_ = others.capacity_;
  const bool in_order = prepare_sort(layout, others.now_, threads);
  move_sorted(in_order, others.now_, now_, threads);
}

// Finds the cells of particles, and where those of each bucket go. Returns whether they are in
// order as they are.
template <class Real, int D>
bool Particles<Real, D>::prepare_sort(const Layout<D>& layout, const Arrays& from, int threads) {
  cells_of_layout_ = layout.size;
  bucket_bits_ = 0;
  while ((layout.size >> bucket_bits_) >= kMaxBuckets) ++bucket_bits_;
  buckets_ = (layout.size >> bucket_bits_) + 1;
  chunk_ = std::max(kMinChunk, (size_ + kMaxChunks - 1) / kMaxChunks);
  cell_.reset(usize(size_));
  first_.reset(usize(layout.size + 1));

  const bool in_order = find_cells(layout, from, threads);
  count_to_places();
  if (in_order) return true;
  entries_.reset(usize(size_));
  source_.reset(usize(size_));
  parallel_for(
      size_, chunk_,
      [&](std::int64_t begin, std::int64_t end) {
        std::int32_t* const place = places_.data() + begin / chunk_ * buckets_;
        for (std::int64_t i = begin; i < end; ++i) {
          const std::int32_t cell = cell_[usize(i)], bucket = cell >> bucket_bits_;
          const std::int32_t to = bucket_first_[usize(bucket)] + place[bucket]++;
          entries_[usize(to)] = {cell, static_cast<std::int32_t>(i)};
        }
      },
      threads);
  return false;
}

template <class Real, int D>
void Particles<Real, D>::move_sorted(bool in_order, const Arrays& from, Arrays& to, int threads) {
  parallel_for(
      buckets_, kBucketsOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) sort_bucket(b, in_order, from, to);
      },
      threads);
}

template <class Real, int D>
std::size_t Particles<Real, D>::bytes() const {
  std::size_t sum = first_.bytes() + cell_.bytes() + entries_.bytes() + source_.bytes() +
                    places_.capacity() * sizeof(places_[0]);
  for (const Arrays* arrays : {&now_, &next_}) {
    for (const auto& numbers : arrays->numbers) sum += numbers.bytes();
    sum += arrays->id.bytes();
  }
  return sum;
}

template class Particles<float, 2>;
template class Particles<float, 3>;
template class Particles<double, 2>;
template class Particles<double, 3>;

}  // namespace substep::gridfluid
