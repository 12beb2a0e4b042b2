#include "substep/gridfluid/flow/semi_lagrangian.h"

#include <algorithm>
#include <cstring>

#include "substep/core/usize.h"
#include "substep/gridfluid/grid/sample.h"

namespace substep::gridfluid {
namespace {

// As many cells or faces of a row as there are lanes.
template <class Real, int D>
class Packets {
 public:
  using V = Vector<Real>;
  using Mask = Indices<V>;
  using Point = std::array<V, D>;
  using Arrays = std::array<AlignedBuffer<Real>, D>;
  static constexpr std::int64_t kLanes = kVectorBytes / static_cast<int>(sizeof(Real));

  explicit Packets(const Layout<D>& layout) : layout_(layout) {
    for (std::int64_t l = 0; l < kLanes; ++l) lanes_[l] = Real(l);
  }

  // The middle of cells, or of the faces below them [cells].
  SUBSTEP_INLINE Point middle(const std::array<int, D>& cell, int faces_of) const {
    Point x;
    for (int d = 0; d < D; ++d) {
      const Real half = d == faces_of ? Real(0) : Real(0.5);
      x[usize(d)] = splat<V>(static_cast<Real>(cell[usize(d)]) + half);
    }
    x[D - 1] += lanes_;
    return x;
  }

  // Through periodic sides, else no further than to the sides, which those of `left` have left; in
  // the box even where x is not finite.
  SUBSTEP_INLINE Point in_box(Point x, Mask* left = nullptr) const {
    for (std::size_t d = 0; d < D; ++d) {
      const V n = splat<V>(static_cast<Real>(layout_.cells[d])), none{};
      if (layout_.periodic[d]) {
        x[d] -= n * floor<V>(x[d] / n);
      } else if (left != nullptr) {
        *left |= ~((x[d] >= none) & (x[d] <= n));
      }
      x[d] = x[d] > none ? x[d] : none;
      x[d] = x[d] < n ? x[d] : n;
    }
    return x;
  }

  SUBSTEP_INLINE Point velocity(const Velocity<Real, D>& u, const Point& x) const {
    const Place<V, D> place(in_box(x), layout_);
    Point v;
    for (int c = 0; c < D; ++c) {
      v[usize(c)] = interpolate<V, D>(u[usize(c)].data(), layout_, c, place);
    }
    return v;
  }

  // How far a path goes from x in h [s/m], from its velocity there.
  SUBSTEP_INLINE Point path(const Velocity<Real, D>& u, const Point& x, const Point& k1,
                            Real h) const {
    const Point k2 = velocity(u, step(x, k1, h / 2));
    const Point k3 = velocity(u, step(x, k2, h * Real(0.75)));
    Point d;
    for (std::size_t a = 0; a < D; ++a) {
      d[a] = h * (Real(2.0 / 9) * k1[a] + Real(3.0 / 9) * k2[a] + Real(4.0 / 9) * k3[a]);
    }
    return d;
  }

  // Where the paths of cells lead, or of the faces of an axis below them.
  SUBSTEP_INLINE Point end(const std::array<int, D>& cell, std::int64_t i, int faces_of,
                           const Arrays& d) const {
    Point x = middle(cell, faces_of);
    std::int64_t below = i, above = i;
    if (faces_of >= 0) {  // along the last axis there are ghosts
      const std::size_t a = usize(faces_of);
      const std::int64_t s = layout_.stride[a], n = layout_.cells[a];
      const bool ghosts = a == D - 1;
      if (ghosts || cell[a] > 0) {
        below -= s;
      } else if (layout_.periodic[a]) {
        below += (n - 1) * s;
      }
      if (!ghosts && cell[a] == n) above -= s;
    }
    for (std::size_t a = 0; a < D; ++a) {
      x[a] += (load<V>(d[a].data() + below) + load<V>(d[a].data() + above)) / 2;
    }
    return x;
  }

  // each(cell, i, lanes) for the packets of a block, of which all lanes but the last ones count.
  template <class Each>
  void for_each(const Block<D>& block, int threads, const Each& each) const {
    for_placed_rows(layout_, block, threads,
                    [&](std::array<int, D> cell, std::int64_t begin, std::int64_t end) {
                      for (std::int64_t i = begin; i < end; i += kLanes) {
                        each(cell, i, std::min(end - i, kLanes));
                        cell[D - 1] += static_cast<int>(kLanes);
                      }
                    });
  }

  static SUBSTEP_INLINE void store(const V& v, Real* to, std::int64_t lanes) {
    if (lanes == kLanes) {
      std::memcpy(to, &v, sizeof v);
    } else {
      std::memcpy(to, &v, usize(lanes) * sizeof(Real));
    }
  }

 private:
  static SUBSTEP_INLINE Point step(const Point& x, const Point& k, Real h) {
    Point to;
    for (std::size_t d = 0; d < D; ++d) to[d] = fma<V>(h, k[d], x[d]);
    return to;
  }

  const Layout<D>& layout_;
  V lanes_;
};

// The smallest and the largest of the 2^D around that count: at a number itself its neighbours do
// not, so that it is the same seen from either side.
template <class V, int D>
SUBSTEP_INLINE std::array<V, 2> extremes(const Corners<V, D>& corners) {
  constexpr int kRows = Corners<V, D>::kRows;
  constexpr Lane<V> kNone = Lane<V>(1e-4);
  const auto pick = [&](std::size_t axis, const V& low, const V& high, bool most)
                        __attribute__((always_inline)) {
                          const V a = 1 - corners.f[axis] > kNone ? low : high;
                          const V b = corners.f[axis] > kNone ? high : low;
                          return most ? (a < b ? b : a) : (a < b ? a : b);
                        };
  std::array<V, 2> found;
  for (const bool most : {false, true}) {
    V row[kRows];
    for (int r = 0; r < kRows; ++r) row[r] = pick(D - 1, corners.low[r], corners.high[r], most);
    V of = pick(D - 2, row[0], row[1], most);
    if constexpr (D == 3) of = pick(0, of, pick(1, row[2], row[3], most), most);
    found[most] = of;
  }
  return found;
}

}  // namespace

template <class Real, int D>
void SemiLagrangian<Real, D>::follow(const Velocity<Real, D>& u, double reach, bool maccormack,
                                     int threads) {
  const auto make = [&](AlignedBuffer<Real>& x) {
    if (x.size() == 0) assign(x, layout_.size, Real(0));
  };
  for (AlignedBuffer<Real>& x : back_) make(x);
  if (maccormack) {
    for (AlignedBuffer<Real>& x : forth_) make(x);
    for (auto* x : {&first_, &low_, &high_}) make(*x);
  }
  maccormack_ = maccormack;
  using P = Packets<Real, D>;
  const P packets(layout_);
  const auto keep = [&](const typename P::Point& d, auto& arrays, std::int64_t i,
                        std::int64_t lanes) __attribute__((always_inline)) {
    for (std::size_t a = 0; a < D; ++a) P::store(d[a], arrays[a].data() + i, lanes);
  };
  const Real h = Real(reach);
  const bool wraps = layout_.periodic[D - 1];
  packets.for_each(
      all_cells(layout_), threads,
      [&](const std::array<int, D>& cell, std::int64_t i, std::int64_t lanes) {
        typename P::Point x = packets.middle(cell, -1), k1;
        for (std::size_t a = 0; a < D; ++a) {
          const Real* v = u[a].data() + i;
          k1[a] = (load<typename P::V>(v) + load<typename P::V>(v + layout_.stride[a])) / 2;
        }
        keep(packets.path(u, x, k1, -h), back_, i, lanes);
        if (maccormack) keep(packets.path(u, x, k1, h), forth_, i, lanes);
        if (cell[D - 1] + lanes < layout_.cells[D - 1]) return;
        const std::int64_t begin = i - cell[D - 1], end = i + lanes;
        for (auto* arrays : {&back_, &forth_}) {
          if (arrays == &forth_ && !maccormack) continue;
          for (AlignedBuffer<Real>& d : *arrays) {  // the ghosts of the row
            d[usize(begin - 1)] = d[usize(wraps ? end - 1 : begin)];
            d[usize(end)] = d[usize(wraps ? begin : end - 1)];
          }
        }
      });
}

template <class Real, int D>
void SemiLagrangian<Real, D>::go_back(int faces_of, const Block<D>& block,
                                      std::span<const Real> from, std::span<Real> to, int threads) {
  using P = Packets<Real, D>;
  using V = typename P::V;
  const P packets(layout_);
  packets.for_each(
      block, threads, [&](const std::array<int, D>& cell, std::int64_t i, std::int64_t lanes) {
        typename P::Mask left{};
        const auto x = packets.in_box(packets.end(cell, i, faces_of, back_), &left);
        const Corners<V, D> corners(from.data(), layout_, faces_of, Place<V, D>(x, layout_));
        const V value = interpolate<V, D>(corners);
        P::store(value, to.data() + i, lanes);
        if (!maccormack_) return;
        const auto [low, high] = extremes<V, D>(corners);
        P::store(left ? value : low, low_.data() + i, lanes);
        P::store(left ? value : high, high_.data() + i, lanes);
      });
}

template <class Real, int D>
void SemiLagrangian<Real, D>::correct(int faces_of, const Block<D>& block,
                                      std::span<const Real> from, std::span<Real> to, int threads) {
  using P = Packets<Real, D>;
  using V = typename P::V;
  const P packets(layout_);
  packets.for_each(
      block, threads, [&](const std::array<int, D>& cell, std::int64_t i, std::int64_t lanes) {
        const auto x = packets.in_box(packets.end(cell, i, faces_of, forth_));
        const V back = interpolate<V, D>(first_.data(), layout_, faces_of, Place<V, D>(x, layout_));
        V value = load<V>(first_.data() + i) + (load<V>(from.data() + i) - back) / 2;
        const V low = load<V>(low_.data() + i), high = load<V>(high_.data() + i);
        value = value < high ? value : high;
        P::store(value > low ? value : low, to.data() + i, lanes);
      });
}

template class SemiLagrangian<float, 2>;
template class SemiLagrangian<float, 3>;
template class SemiLagrangian<double, 2>;
template class SemiLagrangian<double, 3>;

}  // namespace substep::gridfluid
