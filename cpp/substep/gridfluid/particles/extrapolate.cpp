#include "substep/gridfluid/particles/extrapolate.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <functional>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/gridfluid/grid/ghosts.h"

namespace substep::gridfluid {

// Rows along the last axis of the faces that are no ghosts.
template <class Real, int D>
struct Extrapolation<Real, D>::Rows {
  Rows(const Layout<D>& layout_, int c_) : layout(layout_), c(c_) {
    for (std::size_t d = 0; d < D; ++d) {
      const bool both_ends = static_cast<int>(d) == c && !layout.periodic[d];
      faces[d] = layout.cells[d] + (both_ends ? 1 : 0);
    }
  }
  std::int64_t count() const { return D == 2 ? faces[0] : std::int64_t{faces[0]} * faces[1]; }
  std::array<int, 2> place(std::int64_t r) const {
    if constexpr (D == 2) return {static_cast<int>(r), 0};
    return {static_cast<int>(r / faces[1]), static_cast<int>(r % faces[1])};
  }
  std::int64_t index(std::int64_t r) const {
    const auto at = place(r);
    return layout.first + at[0] * layout.stride[0] + (D == 3 ? at[1] * layout.stride[1] : 0);
  }

  // A row next to row r across axis d: how much further its numbers are (0 where there is none),
  // and which row it is or is an image of.
  struct Next {
    std::int64_t offset, row;
  };
  Next next(std::int64_t r, int d, int side) const {
    const auto a = usize(d);
    const std::int64_t rows = D == 3 && d == 0 ? faces[1] : 1;
    int to = place(r)[a] + side;
    if (to < 0 || to >= faces[a]) {
      if (!layout.periodic[a]) return {0, r};
      to += to < 0 ? faces[a] : -faces[a];
    }
    return {side * layout.stride[a], r + (to - place(r)[a]) * rows};
  }

  const Layout<D>& layout;
  int c;
  std::array<int, D> faces;
};

template <class Real, int D>
void Extrapolation<Real, D>::mark(const Layout<D>& layout, int c, const Real* weight,
                                  std::int64_t row) {
  const Rows rows(layout, c);
  const std::int64_t begin = rows.index(row);
  const Real* const __restrict w = weight + begin;
  Real* const __restrict layer = layer_[usize(c)].data() + begin;
  int known = 0;
  const int faces = rows.faces[D - 1];
  for (int k = 0; k < faces; ++k) {
    const bool is = w[k] > 0;
    layer[k] = is ? Real(0) : kUnknown;
    known += is;
  }
  row_has_[usize(c)][usize(row)] =
      static_cast<std::uint8_t>((known > 0 ? kHasKnown : 0) | (known < faces ? kHasUnknown : 0));
}

template <class Real, int D>
void Extrapolation<Real, D>::fill(const Layout<D>& layout, int c, int layer, Real* u,
                                  std::int64_t row) {
  const Rows rows(layout, c);
  std::vector<std::uint8_t>& row_has = row_has_[usize(c)];
  if ((row_has[usize(row)] & kHasUnknown) == 0) return;
  std::array<std::int64_t, usize(2 * D)> around{-1, 1};
  int has = row_has[usize(row)];
  for (int d = 0; d < D - 1; ++d) {
    for (int side = 0; side < 2; ++side) {
      const auto next = rows.next(row, d, 2 * side - 1);
      around[usize(2 * d + 2 + side)] = next.offset;
      has |= row_has[usize(next.row)];
    }
  }
  if ((has & kHasKnown) == 0) return;

  const std::int64_t begin = rows.index(row);
  const int faces = rows.faces[D - 1];
  bool some = false;
  const auto fill_lanes = [&]<class V>(int k, V) {
    Real* const layers = layer_[usize(c)].data() + begin + k;
    Real* const velocity = u + begin + k;
    V sum{}, known{};
    for (const std::int64_t offset : around) {
      const V is = load<V>(layers + offset) < static_cast<Real>(layer) ? V{} + 1 : V{};
      known += is;
      sum = fma<V>(is, load<V>(velocity + offset), sum);
    }
    const auto now = (load<V>(layers) == kUnknown) & (known > 0);
    if (!any(now)) return;
    some = true;
    const V mean = now ? sum / known : load<V>(velocity);
    const V new_layer = now ? V{} + static_cast<Real>(layer) : load<V>(layers);
    std::memcpy(velocity, &mean, sizeof mean);
    std::memcpy(layers, &new_layer, sizeof new_layer);
  };
  constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));
  int k = 0;
  for (; k + kLanes <= faces; k += kLanes) fill_lanes(k, Vector<Real>{});
  for (; k < faces; ++k) fill_lanes(k, Vector<Real, sizeof(Real)>{});
  if (some) row_has[usize(row)] |= kHasKnown;
}

// Rows whose places across sum to an even number, then the others: the neighbours of a row are at
// rest while it is filled.
template <class Real, int D>
void Extrapolation<Real, D>::operator()(const Layout<D>& layout, const ConstFaces<Real, D>& weight,
                                        const Faces<Real, D>& u, int layers, int threads) {
  constexpr std::int64_t kRowsOfTask = 64;
  std::int64_t tasks = 0;  // a component
  for (int c = 0; c < D; ++c) {
    const std::int64_t rows = Rows(layout, c).count();
    row_has_[usize(c)].resize(usize(rows));
    tasks = std::max(tasks, (rows - 1) / kRowsOfTask + 1);
    auto& layer = layer_[usize(c)];
    if (layer.size() != usize(layout.size)) {
      layer.reset(usize(layout.size));
    }
  }
  layers = std::clamp(layers, 0, static_cast<int>(kUnknown) - 1);
  std::vector<std::int64_t> chunks{D, D * tasks, D};
  for (int l = 0; l < layers; ++l) chunks.insert(chunks.end(), {D * tasks, D * tasks, D});

  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const int c = static_cast<int>(chunk % D);
    const std::int64_t kind = phase % 3;
    if (phase == 0) {
      std::fill(layer_[usize(c)].begin(), layer_[usize(c)].end(), kUnknown);
    } else if (kind == 2) {
      fill_ghosts(layout, c, layer_[usize(c)].data());
      fill_ghosts(layout, c, u[usize(c)]);
    } else {
      const Rows rows(layout, c);
      const std::int64_t begin = chunk / D * kRowsOfTask;
      for (std::int64_t r = begin; r < std::min(begin + kRowsOfTask, rows.count()); ++r) {
        if (phase == 1) {
          mark(layout, c, weight[usize(c)], r);
        } else if (((rows.place(r)[0] + rows.place(r)[1]) & 1) == kind) {
          fill(layout, c, static_cast<int>(phase / 3), u[usize(c)], r);
        }
      }
    }
  };
  parallel_phases(chunks, std::cref(run), threads);
}

template class Extrapolation<float, 2>;
template class Extrapolation<float, 3>;
template class Extrapolation<double, 2>;
template class Extrapolation<double, 3>;

}  // namespace substep::gridfluid
