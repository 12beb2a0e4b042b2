#include "substep/fields/grid.h"

#include <algorithm>
#include <limits>
#include <string>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::fields {
namespace {

// Spacing is equal where every node lies within 1e-9 spacings of its place.
bool equally_spaced(const std::vector<double>& x) {
  const double h = (x.back() - x.front()) / static_cast<double>(x.size() - 1);
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (std::abs(x[i] - (x.front() + static_cast<double>(i) * h)) > 1e-9 * h) return false;
  }
  return true;
}

}  // namespace

template <class T, int kDim>
Grid<T, kDim>::Grid(const std::vector<Axis>& axes, bool cubic, double radius)
    : cubic_(cubic), degrees_(radius > 0 ? T(180 / (std::numbers::pi * radius)) : T(0)) {
  for (int d = 0; d < kDim; ++d) {
    const Axis& axis = axes[usize(d)];
    std::vector<double> x = axis.nodes;
    count_[d] = static_cast<std::int64_t>(x.size());
    padded_[d] = count_[d] + 3;
    if (axis.closed) x.push_back(x.front() + axis.wrap);
    const auto cells = static_cast<std::int64_t>(x.size()) - 1;
    edge_[d].assign(x.begin(), x.end());
    wrap_[d] = T(axis.wrap);
    closed_[d] = axis.closed;
    wrapped_ |= axis.wrap > 0;
    uniform_ &= equally_spaced(x);

    const double h = (x.back() - x.front()) / static_cast<double>(cells);
    const T slack = T(4 * static_cast<double>(cells)) * std::numeric_limits<T>::epsilon();
    origin_[d] = T(x.front());
    inverse_[d] = T(1 / h);
    turn_[d] = T(axis.wrap / h);
    if (axis.closed) turn_[d] = T(cells);
    inverse_wrap_[d] = axis.wrap > 0 ? T(1 / axis.wrap) : T(0);
    low_[d] = -slack;
    high_[d] = T(cells) + slack;
    last_[d] = static_cast<std::int32_t>(cells - 1);

    // The spacing before the first and after the last cell: the neighbour's where the axis closes,
    // else its own, at which fill_ghosts places the ghosts.
    const auto width = [&](std::int64_t i) {
      if (axis.closed) i = (i + cells) % cells;
      i = std::clamp<std::int64_t>(i, 0, cells - 1);
      return x[usize(i) + 1] - x[usize(i)];
    };
    for (std::int64_t i = 0; i < cells; ++i) {
      const double before = width(i - 1), own = width(i), after = width(i + 1);
      spacing_[d].push_back({T(own * own / (before * (before + own))), T(before / (before + own)),
                             T(after / (own + after)), T(own * own / (after * (own + after)))});
    }
  }
  std::int64_t stride = 1;
  for (int d = kDim - 1; d >= 0; --d) {
    stride_[d] = stride;
    first_ += stride;
    stride *= padded_[d];
  }
}

template <class T, int kDim>
std::int64_t Grid<T, kDim>::node_count() const {
  return padded_[0] * padded_[1] * padded_[2];
}

template <class T, int kDim>
auto Grid<T, kDim>::unequal_coordinate(V4 x) const -> V4 {
  V4 q{};
  for (int d = 0; d < kDim; ++d) {
    const std::vector<T>& edge = edge_[d];
    T p = x[d];
    if (wrap_[d] > 0) p -= wrap_[d] * std::floor((p - edge.front()) / wrap_[d]);
    auto i = std::upper_bound(edge.begin(), edge.end(), p) - edge.begin() - 1;
    i = std::clamp<std::ptrdiff_t>(i, 0, static_cast<std::ptrdiff_t>(edge.size()) - 2);
    const auto at = usize(i);
    q[d] = T(i) + (p - edge[at]) / (edge[at + 1] - edge[at]);
  }
  return q;
}

// Cubic Hermite polynomial with the values f0, f1 and the slopes of the parabolas through three
// neighbours, h d0 = a (f0 - fm) + b (f1 - f0), h d1 = c (f1 - f0) + e (f2 - f1); with equal
// spacing a = b = c = e = 1/2, which is Keys' eq. (15).
template <class T, int kDim>
void Grid<T, kDim>::cubic_weights(int axis, T s, std::int32_t index, T w[4]) const {
  const auto [a, b, c, e] = spacing_[axis][usize(index)];
  const T r = 1 - s;
  const T h00 = (1 + 2 * s) * r * r, h10 = s * r * r, h01 = s * s * (3 - 2 * s), h11 = -s * s * r;
  w[0] = -a * h10;
  w[1] = h00 + (a - b) * h10 - c * h11;
  w[2] = h01 + b * h10 + (c - e) * h11;
  w[3] = e * h11;
}

template <class T, int kDim>
auto Grid<T, kDim>::cubic(const Level<T>& level, V4 fraction, I4 index, std::int64_t offset) const
    -> V4 {
  T w[3][4];
  for (int d = 0; d < kDim; ++d) cubic_weights(d, fraction[d], index[d], w[d]);
  const T* g = level.nodes[usize(offset)].value;
  V8 low{}, high{};  // sums over the rows, of the nodes -1, 0 and of 1, 2 along the last axis
  for (std::int64_t i = 0; i < 4; ++i) {
    for (std::int64_t j = 0; j < (kDim == 3 ? 4 : 1); ++j) {
      std::int64_t node = (i - 1) * stride_[0] - 1;
      T weight = w[0][i];
      if constexpr (kDim == 3) {
        node += (j - 1) * stride_[1];
        weight *= w[1][j];
      }
      low = fma<V8>(weight, load<V8>(g + 4 * node), low);
      high = fma<V8>(weight, load<V8>(g + 4 * node + 8), high);
    }
  }
  const T* along = w[kDim - 1];
  V4 u = along[0] * V4(__builtin_shufflevector(low, low, 0, 1, 2, 3));
  u = fma<V4>(along[1], V4(__builtin_shufflevector(low, low, 4, 5, 6, 7)), u);
  u = fma<V4>(along[2], V4(__builtin_shufflevector(high, high, 0, 1, 2, 3)), u);
  return fma<V4>(along[3], V4(__builtin_shufflevector(high, high, 4, 5, 6, 7)), u);
}

template <class T, int kDim>
auto Grid<T, kDim>::among_land(const Slice<T>& slice, V4 fraction, std::int64_t offset,
                               V4 sum) const -> V4 {
  std::int64_t nearest = offset;
  for (int d = 0; d < kDim; ++d) nearest += fraction[d] >= T(0.5) ? stride_[d] : 0;
  const Level<T>& level = slice.high && slice.weight >= T(0.5) ? *slice.high : *slice.low;
  if (level.nodes[usize(nearest)].value[3] == 0) return V4{};
  return sum / sum[3];
}

template <class T, int kDim>
Level<T> Grid<T, kDim>::pack(const double* values, int threads) const {
  Level<T> level;
  level.nodes.resize(usize(node_count()), Node<T>{});
  const std::int64_t rows = count_[0], per_row = count_[1] * count_[2];
  parallel_for(
      rows, 1,
      [&](std::int64_t begin, std::int64_t) {
        for (std::int64_t k = 0; k < per_row; ++k) {
          const std::int64_t flat = begin * per_row + k;
          const double* u = values + flat * kDim;
          const std::int64_t index[3] = {begin, kDim == 3 ? k / count_[2] : k, k % count_[2]};
          std::int64_t offset = 0;
          for (int d = 0; d < kDim; ++d) offset += (index[d] + 1) * stride_[d];
          Node<T>& node = level.nodes[usize(offset)];
          bool missing = false;
          for (int d = 0; d < kDim; ++d) {
            missing |= std::isnan(u[d]);
            if (std::abs(u[d]) > static_cast<double>(std::numeric_limits<T>::max())) {
              throw InputError("values: expected finite numbers or NaN, got " +
                               std::to_string(u[d]) + " at node " + std::to_string(flat));
            }
          }
          if (missing) continue;
          for (int d = 0; d < kDim; ++d) node.value[d] = T(u[d]);
          node.value[3] = 1;
        }
      },
      threads);
  for (int d = 0; d < kDim; ++d) fill_ghosts(d, level.nodes);
  if (cubic_) find_whole(level);
  return level;
}

// Copies where the axis closes; else the parabola through the three outermost nodes (Keys' eq.
// (19), (25) with equal spacing), one own spacing further out. The second ghost is never read
// there.
template <class T, int kDim>
void Grid<T, kDim>::fill_ghosts(int axis, std::vector<Node<T>>& nodes) const {
  const std::int64_t n = count_[axis], stride = stride_[axis];
  const std::int64_t total = static_cast<std::int64_t>(nodes.size());
  const auto extrapolate = [&](Node<T>* edge, std::int64_t inward, double h0, double h1) {
    // Lagrange weights at -h0 of the nodes 0, h0, h0 + h1 (or of two nodes).
    const double w0 = n > 2 ? 2 * (2 * h0 + h1) / (h0 + h1) : 2;
    const double w1 = n > 2 ? -(2 * h0 + h1) / h1 : -1;
    const double w2 = n > 2 ? 2 * h0 * h0 / (h1 * (h0 + h1)) : 0;
    const Node<T>& second = edge[inward];
    const Node<T>& third = n > 2 ? edge[2 * inward] : second;
    Node<T>& ghost = edge[-inward];
    ghost = {};
    if (edge->value[3] == 0 || second.value[3] == 0 || third.value[3] == 0) return;
    for (int c = 0; c < kDim; ++c) {
      ghost.value[c] =
          T(w0 * static_cast<double>(edge->value[c]) + w1 * static_cast<double>(second.value[c]) +
            w2 * static_cast<double>(third.value[c]));
    }
    ghost.value[3] = 1;
  };
  const std::vector<T>& x = edge_[axis];
  const auto width = [&](std::int64_t i) {
    i = std::clamp<std::int64_t>(i, 0, static_cast<std::int64_t>(x.size()) - 2);
    const auto at = usize(i);
    return static_cast<double>(x[at + 1]) - static_cast<double>(x[at]);
  };
  for (std::int64_t base = 0; base < total; ++base) {
    if (base / stride % padded_[axis] != 0) continue;  // one line of nodes along the axis each
    Node<T>* line = nodes.data() + base;
    if (closed_[axis]) {
      line[0] = line[n * stride];
      line[(n + 1) * stride] = line[stride];
      line[(n + 2) * stride] = line[(n > 1 ? 2 : 1) * stride];
    } else {
      extrapolate(line + stride, stride, width(0), width(1));
      extrapolate(line + n * stride, -stride, width(n - 2), width(n - 3));
    }
  }
}

template <class T, int kDim>
void Grid<T, kDim>::find_whole(Level<T>& level) const {
  // Separable: along each axis in turn, all four of -1, 0, 1, 2.
  const std::size_t total = level.nodes.size();
  level.whole.resize(total);
  for (std::size_t i = 0; i < total; ++i) level.whole[i] = level.nodes[i].value[3] != 0;
  for (int d = 0; d < kDim; ++d) {
    const auto stride = usize(stride_[d]);
    std::vector<std::uint8_t> along(total, 0);
    for (std::size_t i = stride; i + 2 * stride < total; ++i) {
      along[i] = level.whole[i - stride] & level.whole[i] & level.whole[i + stride] &
                 level.whole[i + 2 * stride];
    }
    level.whole.swap(along);
  }
}

template <class T, int kDim>
std::int64_t Grid<T, kDim>::block(const V4& x) const {
  const Cell cell = locate(x);
  if (cell.outside) return 0;
  const std::int64_t at[3] = {cell.index[0], cell.index[1], cell.index[2]};
  return block_of(at, count_);
}

template <class T, int kDim>
std::int64_t Grid<T, kDim>::block_count() const {
  return blocks_in(count_);
}

template class Grid<double, 2>;
template class Grid<double, 3>;
template class Grid<float, 2>;
template class Grid<float, 3>;

}  // namespace substep::fields
