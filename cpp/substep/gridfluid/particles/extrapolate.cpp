#include "substep/gridfluid/particles/extrapolate.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <functional>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/gridfluid/grid/ghosts.h"
#include "substep/gridfluid/grid/loops.h"

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
  struct Place {
    std::int64_t row;
    int k, j;
  };
  Place place(std::int64_t r) const {
    if constexpr (D == 2) return {r, static_cast<int>(r), 0};
    const int row = static_cast<int>(r), k = row / faces[1];
    return {r, k, row - k * faces[1]};
  }
  std::int64_t index(const Place& at) const {
    return layout.first + at.k * layout.stride[0] + (D == 3 ? at.j * layout.stride[1] : 0);
  }

  // A row next to another across axis d: how much further its numbers are (0 where there is none),
  // and which row it is or is an image of.
  struct Next {
    std::int64_t offset, row;
  };
  Next next(const Place& at, std::size_t d, int side) const {
    const std::int64_t rows = D == 3 && d == 0 ? faces[1] : 1;
    const int from = d == 0 ? at.k : at.j;
    int to = from + side;
    if (to < 0 || to >= faces[d]) {
      if (!layout.periodic[d]) return {0, at.row};
      to += to < 0 ? faces[d] : -faces[d];
    }
    return {side * layout.stride[d], at.row + (to - from) * rows};
  }

  const Layout<D>& layout;
  int c;
  std::array<int, D> faces;
};

template <class Real, int D>
void Extrapolation<Real, D>::mark(const Layout<D>& layout, int c, const Real* weight,
                                  std::int64_t row) {
  const Rows rows(layout, c);
  const std::int64_t begin = rows.index(rows.place(row));
  const Real* const __restrict w = weight + begin;
  Real* const __restrict layer = layer_[usize(c)].data() + begin;
  int known = 0;
  const int faces = rows.faces[D - 1];
  for (int k = 0; k < faces; ++k) {
    const bool is = w[k] > 0;
    layer[k] = is ? Real(0) : kUnknown;
    known += is;
  }
  if (!layout.periodic[D - 1]) layer[-1] = layer[faces] = kUnknown;
  const auto hull = [&](bool of_known, int count) -> Range {
    if (count == 0) return {faces, 0};
    Range range{0, faces};
    while ((layer[range.begin] == 0) != of_known) ++range.begin;
    while ((layer[range.end - 1] == 0) != of_known) --range.end;
    return range;
  };
  known_[usize(c)][usize(row)] = hull(true, known);
  unknown_[usize(c)][usize(row)] = hull(false, faces - known);
}

template <class Real, int D>
void Extrapolation<Real, D>::fill(const Layout<D>& layout, int c, int layer, Real* u,
                                  std::int64_t row) {
  const Rows rows(layout, c);
  const int faces = rows.faces[D - 1];
  const typename Rows::Place at = rows.place(row);
  const Range unknown = unknown_[usize(c)][usize(row)];
  Range& known = known_[usize(c)][usize(row)];
  std::array<std::int64_t, usize(2 * D)> around{-1, 1};
  Range reached{known.begin - 1, known.end + 1};
  for (std::size_t d = 0; d < D - 1; ++d) {
    for (int side = 0; side < 2; ++side) {
      const auto next = rows.next(at, d, 2 * side - 1);
      around[2 * d + 2 + usize(side)] = next.offset;
      const Range theirs = known_[usize(c)][usize(next.row)];
      reached = {std::min(reached.begin, theirs.begin), std::max(reached.end, theirs.end)};
    }
  }
  if (layout.periodic[D - 1] && reached.begin < reached.end) reached = {0, faces};
  reached = {std::max(reached.begin, unknown.begin), std::min(reached.end, unknown.end)};
  if (reached.begin >= reached.end) return;

  const std::int64_t begin = rows.index(at);
  bool some = false;
  const auto fill_lanes = [&]<class V>(int k, V) {
    Real* const layers = layer_[usize(c)].data() + begin + k;
    Real* const velocity = u + begin + k;
    V sum{}, count{};
    for (const std::int64_t offset : around) {
      const V is = load<V>(layers + offset) < static_cast<Real>(layer) ? V{} + 1 : V{};
      count += is;
      sum = fma<V>(is, load<V>(velocity + offset), sum);
    }
    const auto now = (load<V>(layers) == kUnknown) & (count > 0);
    if (!any(now)) return;
    some = true;
    const V mean = now ? sum / count : load<V>(velocity);
    const V new_layer = now ? V{} + static_cast<Real>(layer) : load<V>(layers);
    std::memcpy(velocity, &mean, sizeof mean);
    std::memcpy(layers, &new_layer, sizeof new_layer);
  };
  constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));
  reached.begin = reached.begin / kLanes * kLanes;  // no more is found by whole lanes
  reached.end = std::min((reached.end + kLanes - 1) / kLanes * kLanes, faces);
  int k = reached.begin;
  for (; k + kLanes <= reached.end; k += kLanes) fill_lanes(k, Vector<Real>{});
  for (; k < reached.end; ++k) fill_lanes(k, Vector<Real, sizeof(Real)>{});
  if (some) known = {std::min(known.begin, reached.begin), std::max(known.end, reached.end)};
}

// Rows whose places across sum to an even number, then the others: the neighbours of a row are at
// rest while it is filled. Across closed sides there are no neighbours; the ghosts beyond, images
// of the faces within, would tell nothing new.
template <class Real, int D>
void Extrapolation<Real, D>::operator()(const Layout<D>& layout, const ConstFaces<Real, D>& weight,
                                        const Faces<Real, D>& u, int layers, int threads) {
  constexpr std::int64_t kRowsOfTask = 64;
  std::int64_t tasks = 0;  // a component
  for (int c = 0; c < D; ++c) {
    const std::int64_t rows = Rows(layout, c).count();
    known_[usize(c)].resize(usize(rows)), unknown_[usize(c)].resize(usize(rows));
    tasks = std::max(tasks, (rows - 1) / kRowsOfTask + 1);
    if (layer_[usize(c)].size() != usize(layout.size))
      assign(layer_[usize(c)], layout.size, kUnknown);
  }
  layers = std::clamp(layers, 0, static_cast<int>(kUnknown) - 1);
  const bool periodic =
      std::find(layout.periodic.begin(), layout.periodic.end(), true) != layout.periodic.end();
  const std::int64_t between = periodic ? D : 0;
  std::vector<std::int64_t> chunks{D * tasks, between};  // and even rows, odd rows, ghosts
  for (int l = 0; l < layers; ++l) chunks.insert(chunks.end(), {D * tasks, D * tasks, between});
  chunks.back() = D;

  const auto run = [&](std::int64_t phase, std::int64_t chunk) {
    const int c = static_cast<int>(chunk % D);
    if (phase % 3 == 1) {
      if (periodic) fill_ghosts(layout, c, layer_[usize(c)].data());
      return fill_ghosts(layout, c, u[usize(c)]);
    }
    const Rows rows(layout, c);
    const auto parity = [&](std::int64_t r) { return (rows.place(r).k + rows.place(r).j) & 1; };
    const std::int64_t begin = chunk / D * kRowsOfTask;
    for (std::int64_t r = begin; r < std::min(begin + kRowsOfTask, rows.count()); ++r) {
      if (phase == 0) {
        mark(layout, c, weight[usize(c)], r);
      } else if (parity(r) == (phase % 3 == 0)) {
        fill(layout, c, static_cast<int>((phase + 1) / 3), u[usize(c)], r);
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
