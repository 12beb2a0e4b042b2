// The sweep over the overlapped tiles of a chain of n cells with two fields; see chain.h.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::ode {

// 512 cells: a Runge-Kutta step's arrays stay in the first-level cache. The chunks of the thread
// pool are whole tiles, done in order, so that only chunk boundaries need a copy kept beforehand.
inline constexpr std::int64_t kTile = 512, kHalo = 48, kChunk = 64 * kTile;
static_assert(kHalo <= kTile);

// One array over a tile and its halos, with room for a ghost cell at both ends; cell 0 is aligned.
struct TileArray {
  static constexpr std::int64_t kFirst = 8;
  alignas(64) double cells[kFirst + kTile + 2 * kHalo + 8];
  double* data() { return cells + kFirst; }
};

struct Tile {
  double *x, *v;        // cells 0 .. size - 1
  std::int64_t size;    // with halos
  std::int64_t origin;  // index of cell 0 in the chain
  bool left_end, right_end;
};

class ChainSweep {
 public:
  ChainSweep(std::int64_t n, double* x, double* v, int threads)
      : n_(n), x_(x), v_(v), threads_(threads), chunks_((n + kChunk - 1) / kChunk) {
    strips_.resize(usize(std::max<std::int64_t>(chunks_ - 1, 0)));
  }

  // `steps` steps of the kernels that make_kernel() gives, one for each chunk: kernel(tile, steps)
  // advances the copy, and may swap its arrays for its own of the same extent. What is `halo` (at
  // most kHalo) cells or more from a cut must come out right.
  template <class MakeKernel>
  void operator()(std::int64_t halo, std::int64_t steps, MakeKernel&& make_kernel) {
    for (std::int64_t c = 0; c + 1 < chunks_; ++c) strips_[c].keep(*this, (c + 1) * kChunk, halo);
    parallel_chunks(
        chunks_, [&](std::int64_t c) { do_chunk(c, halo, steps, make_kernel); }, threads_);
  }

 private:
  // Old values on both sides of a chunk boundary.
  struct Strip {
    double left_x[kHalo], left_v[kHalo], right_x[kHalo], right_v[kHalo];
    void keep(const ChainSweep& sweep, std::int64_t at, std::int64_t halo) {
      const std::int64_t right = std::min(halo, sweep.n_ - at);
      std::copy_n(sweep.x_ + at - halo, halo, left_x);
      std::copy_n(sweep.v_ + at - halo, halo, left_v);
      std::copy_n(sweep.x_ + at, right, right_x);
      std::copy_n(sweep.v_ + at, right, right_v);
    }
  };

  template <class MakeKernel>
  void do_chunk(std::int64_t c, std::int64_t halo, std::int64_t steps, MakeKernel& make_kernel) {
    auto kernel = make_kernel();
    const std::int64_t chunk_end = std::min((c + 1) * kChunk, n_);
    double left_x[kHalo], left_v[kHalo];  // old values left of the next tile
    if (c > 0) {
      std::copy_n(strips_[c - 1].left_x, halo, left_x);
      std::copy_n(strips_[c - 1].left_v, halo, left_v);
    }
    TileArray copy_x, copy_v;
    for (std::int64_t begin = c * kChunk; begin < chunk_end; begin += kTile) {
      const std::int64_t end = std::min(begin + kTile, chunk_end);
      const std::int64_t left = begin > 0 ? halo : 0, right = std::min(halo, n_ - end);
      Tile tile{.x = copy_x.data(),
                .v = copy_v.data(),
                .size = left + (end - begin) + right,
                .origin = begin - left,
                .left_end = begin == 0,
                .right_end = end + right == n_};
      const bool inside = end < chunk_end || end == n_;
      const double* right_x = inside ? x_ + end : strips_[c].right_x;
      const double* right_v = inside ? v_ + end : strips_[c].right_v;
      const auto fill = [&](double* to, const double* a, const double* b, const double* d) {
        std::copy_n(d, right, std::copy_n(b + begin, end - begin, std::copy_n(a, left, to)));
      };
      fill(tile.x, left_x, x_, right_x);
      fill(tile.v, left_v, v_, right_v);
      if (end < chunk_end) {
        std::copy_n(x_ + end - halo, halo, left_x);
        std::copy_n(v_ + end - halo, halo, left_v);
      }
      kernel(tile, steps);
      std::copy_n(tile.x + left, end - begin, x_ + begin);
      std::copy_n(tile.v + left, end - begin, v_ + begin);
    }
  }

  std::int64_t n_;
  double *x_, *v_;
  int threads_;
  std::int64_t chunks_;
  std::vector<Strip> strips_;
};

}  // namespace substep::ode
