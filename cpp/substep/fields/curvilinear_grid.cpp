#include "substep/fields/curvilinear_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>

#include "substep/core/errors.h"
#include "substep/core/parallel.h"

namespace substep::fields {
namespace {

constexpr double kDegree = std::numbers::pi / 180;

// How far outside of a cell rounding may put a point of its edge.
template <class T>
constexpr double kSlack = std::is_same_v<T, float> ? 1e-4 : 1e-9;

}  // namespace

template <class T, int kDim>
CurvilinearGrid<T, kDim>::CurvilinearGrid(Corners corners, std::vector<double> z,
                                          Staggering staggering, double radius)
    : cells_(std::move(corners), radius > 0 ? 360 : 0),
      z_(std::move(z)),
      staggering_(staggering),
      degree_(radius * kDegree) {
  count_[0] = cells_.corners().rows;
  count_[1] = cells_.corners().columns;
  if (kDim == 3) count_[2] = static_cast<std::int64_t>(z_.size());
  stride_[0] = count_[1] * count_[2];
  stride_[1] = count_[2];
  stride_[2] = kDim == 3 ? 1 : 0;
  if (staggering_ == Staggering::kCorners) return;
  const auto length = [&](const Vec2& from, const Vec2& to) {
    const double parallel = degree_ > 0 ? std::cos(kDegree * 0.5 * (from[1] + to[1])) : 1;
    return (degree_ > 0 ? degree_ : 1) * std::hypot((to[0] - from[0]) * parallel, to[1] - from[1]);
  };
  lengths_.reserve(usize(count_[0] * count_[1]));
  for (std::int64_t i = 0; i < count_[0]; ++i) {
    for (std::int64_t j = 0; j < count_[1]; ++j) {
      const Vec2 from = cells_.corner(i, j, 0);
      const auto to = [&](std::int64_t a, std::int64_t b) {
        return cells_.corner(std::min(a, count_[0] - 1), std::min(b, count_[1] - 1), from[0]);
      };
      lengths_.push_back({length(from, to(i, j + 1)), length(from, to(i + 1, j))});
    }
  }
}

template <class T, int kDim>
Level<T> CurvilinearGrid<T, kDim>::pack(const double* values, int threads) const {
  // On faces a missing component lets nothing pass; which of u and v are known is a sum of bits.
  const bool faces = staggering_ == Staggering::kFaces;
  Level<T> level;
  level.nodes.resize(usize(node_count()), Node<T>{});
  parallel_for(
      node_count(), 4096,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const double* u = values + k * kDim;
          Node<T> node{};
          int known = 0;
          for (int d = 0; d < kDim; ++d) {
            if (std::abs(u[d]) > static_cast<double>(std::numeric_limits<T>::max())) {
              throw InputError("values: expected finite numbers or NaN, got " +
                               std::to_string(u[d]) + " at node " + std::to_string(k));
            }
            if (std::isnan(u[d])) continue;
            node.value[d] = T(u[d]);
            known |= 1 << d;
          }
          if (faces) {
            node.value[3] = T(known & 3);
          } else if (known == (1 << kDim) - 1) {
            node.value[3] = 1;
          } else {
            node = {};
          }
          level.nodes[usize(k)] = node;
        }
      },
      threads);
  return level;
}

template <class T, int kDim>
bool CurvilinearGrid<T, kDim>::find(const V4& x, Spot& spot, Hint& hint) const {
  const double lat = static_cast<double>(x[1]);
  if constexpr (kDim == 3) {
    const double z = static_cast<double>(x[2]), slack = kSlack<T> * (z_.back() - z_.front());
    if (!(z >= z_.front() - slack && z <= z_.back() + slack)) return false;
    const auto above = std::upper_bound(z_.begin(), z_.end(), z) - z_.begin() - 1;
    spot.k = std::clamp<std::int64_t>(above, 0, count_[2] - 2);
    const auto at = usize(spot.k);
    spot.zeta = (z - z_[at]) / (z_[at + 1] - z_[at]);
  }
  spot.cell = cells_.locate({static_cast<double>(x[0]), lat}, kSlack<T>, hint.cell);
  if (spot.cell.i < 0) return false;
  spot.offset = spot.cell.i * stride_[0] + spot.cell.j * stride_[1] + spot.k;
  if (degree_ > 0) spot.metres = {degree_ * std::cos(kDegree * lat), degree_};
  return true;
}

template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::node(const Slice<T>& slice, std::int64_t offset) const -> Numbers {
  Numbers sum;
  const auto weight = static_cast<double>(slice.weight);
  for (std::size_t c = 0; c < 4; ++c) {
    sum[c] = static_cast<double>(slice.low->nodes[usize(offset)].value[c]);
    if (slice.high == nullptr) continue;
    sum[c] += weight * (static_cast<double>(slice.high->nodes[usize(offset)].value[c]) - sum[c]);
  }
  return sum;
}

// (u, v[, w]); see grid.h for land.
template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::on_corners(const Slice<T>& slice, const Spot& spot,
                                          Place& place) const -> Numbers {
  const double s[3] = {spot.cell.s[0], spot.cell.s[1], spot.zeta};
  Numbers sum{};
  std::int64_t nearest = spot.offset;
  for (int d = 0; d < kDim; ++d) nearest += s[d] >= 0.5 ? stride_[d] : 0;
  for (int corner = 0; corner < 1 << kDim; ++corner) {
    double weight = 1;
    std::int64_t offset = spot.offset;
    for (int d = 0; d < kDim; ++d) {
      const bool high = (corner >> d & 1) != 0;
      weight *= high ? s[d] : 1 - s[d];
      offset += high ? stride_[d] : 0;
    }
    const Numbers u = node(slice, offset);
    for (std::size_t c = 0; c < 4; ++c) sum[c] += weight * u[c];
  }
  const Level<T>& level = slice.high && slice.weight >= T(0.5) ? *slice.high : *slice.low;
  if (level.nodes[usize(nearest)].value[3] == 0) {
    if (place == Place::kSea) place = Place::kLand;
    return {};
  }
  return {sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], 0};
}

// (dxi/dt, deta/dt[, w]).
template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::on_faces(const Slice<T>& slice, const Spot& spot, Place& place) const
    -> Numbers {
  const auto [xi, eta] = spot.cell.s;
  const Numbers low = node(slice, spot.offset), right = node(slice, spot.offset + stride_[0]),
                above = node(slice, spot.offset + stride_[1]);
  const auto known = [&](std::int64_t offset, int bit) {
    const auto of = [&](const Level<T>& level) {
      return (static_cast<int>(level.nodes[usize(offset)].value[3]) & bit) != 0;
    };
    return of(*slice.low) || (slice.high != nullptr && of(*slice.high));
  };
  if (!known(spot.offset, 1) && !known(spot.offset, 2) && !known(spot.offset + stride_[0], 1) &&
      !known(spot.offset + stride_[1], 2)) {
    if (place == Place::kSea) place = Place::kLand;
    return {};
  }
  const auto& [i, j, s, by_xi, by_eta] = spot.cell;
  const double area =
      std::abs(by_xi[0] * by_eta[1] - by_xi[1] * by_eta[0]) * spot.metres[0] * spot.metres[1];
  const auto face = usize(i * count_[1] + j);
  const double along_i =
      (1 - xi) * low[0] * lengths_[face][0] + xi * right[0] * lengths_[face + usize(count_[1])][0];
  const double along_j =
      (1 - eta) * low[1] * lengths_[face][1] + eta * above[1] * lengths_[face + 1][1];
  const double up =
      kDim == 3 ? low[2] + spot.zeta * (node(slice, spot.offset + stride_[2])[2] - low[2]) : 0;
  return {along_i / area, along_j / area, up, 0};
}

template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::motion(const Slice<T>& slice, const V4& x, Place& place, Spot& spot,
                                      Hint& hint) const -> Numbers {
  if (!find(x, spot, hint)) {
    if (place == Place::kSea) place = Place::kOutside;
    return {};
  }
  if (staggering_ == Staggering::kCorners) {
    const Numbers u = on_corners(slice, spot, place);
    return {u[0] / spot.metres[0], u[1] / spot.metres[1], u[2], 0};
  }
  const Numbers s = on_faces(slice, spot, place);
  const auto& [i, j, at, by_xi, by_eta] = spot.cell;
  return {s[0] * by_xi[0] + s[1] * by_eta[0], s[0] * by_xi[1] + s[1] * by_eta[1], s[2], 0};
}

template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::rate(const Slice<T>& slice, const V4& x, Place& place,
                                    Hint& hint) const -> V4 {
  Spot spot;
  const Numbers u = motion(slice, x, place, spot, hint);
  return V4{T(u[0]), T(u[1]), T(u[2]), 0};
}

template <class T, int kDim>
auto CurvilinearGrid<T, kDim>::velocity(const Slice<T>& slice, const V4& x, Place& place) const
    -> V4 {
  Spot spot;
  Hint hint;
  const Numbers u = motion(slice, x, place, spot, hint);
  return V4{T(u[0] * spot.metres[0]), T(u[1] * spot.metres[1]), T(u[2]), 0};
}

template <class T, int kDim>
std::int64_t CurvilinearGrid<T, kDim>::block(const V4& x) const {
  Spot spot;
  Hint hint;
  if (!find(x, spot, hint)) return 0;
  const std::int64_t at[3] = {spot.cell.i, spot.cell.j, spot.k};
  return block_of(at, count_);
}

template <class T, int kDim>
std::int64_t CurvilinearGrid<T, kDim>::block_count() const {
  return blocks_in(count_);
}

template class CurvilinearGrid<double, 2>;
template class CurvilinearGrid<double, 3>;
template class CurvilinearGrid<float, 2>;
template class CurvilinearGrid<float, 3>;

}  // namespace substep::fields
