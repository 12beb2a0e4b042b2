#include "substep/mpm/boundary/node_distances.h"

#include <algorithm>
#include <cmath>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::mpm {
namespace {

using geometry::Vec3;
using transfer::kBlock;

// Rounding of a node's position must not decide whether it lies on a surface.
constexpr double kTolerance = 1e-6;  // cells

template <int D>
Vec3 corner(std::uint64_t key, double cell) {
  Vec3 x = Vec3::Zero();
  const auto block = transfer::BlockKey<D>::unpack(key);
  for (int d = 0; d < D; ++d) {
    x[d] = cell * (static_cast<double>(kBlock) * block[usize(d)]);
  }
  return x;
}

// Groups of 2^D nodes that are surely free are not looked at one by one: about half of them.
template <class Real, int D>
void sample(const geometry::Collider& collider, int axis, std::uint64_t key, double cell,
            double reach, Real* values) {
  constexpr int kHalf = kBlock / 2;
  const double near = reach + kTolerance * cell;
  const double clear = lipschitz(collider, axis) * 0.5 * std::sqrt(D) * cell + near;
  const Vec3 first = corner<D>(key, cell);
  for (int group = 0; group < 1 << D; ++group) {
    Vec3 centre = first;
    for (int d = 0; d < D; ++d) centre[d] += cell * (kHalf * (group >> d & 1) + 0.5);
    const bool free = signed_distance(collider, axis, centre).value > clear;
    for (int member = 0; member < 1 << D; ++member) {
      Vec3 x = first;
      int node = 0;
      for (int d = 0; d < D; ++d) {
        const int i = kHalf * (group >> d & 1) + (member >> d & 1);
        x[d] += cell * i;
        node = node * kBlock + i;
      }
      Real* const value = values + 4 * node;
      std::fill_n(value, 4, static_cast<Real>(cell));
      if (free) continue;
      auto [distance, n] = signed_distance(collider, axis, x);
      if constexpr (D == 2) n[2] = 0;
      const double length = n.norm();
      if (length > 0) n /= length;
      for (int d = 0; d < 3; ++d) value[d] = static_cast<Real>(n[d]);
      value[3] = static_cast<Real>(distance - near);
    }
  }
}

}  // namespace

template <class Real, int D>
void NodeDistances<Real, D>::update(const transfer::BlockLayout<D>& layout, bool layout_changed,
                                    std::span<const geometry::Collider> colliders, int threads) {
  surfaces_ = surfaces(colliders);
  fields_.resize(surfaces_.size());
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    const geometry::Collider& collider = colliders[surfaces_[s].collider];
    const auto state = collider.state();
    std::array<double, kPose> pose;
    std::copy_n(state.begin(), kPose, pose.begin());
    const bool moved = pose != fields_[s].pose || collider.shapes() != fields_[s].shapes;
    if (!moved && !layout_changed) continue;
    fields_[s] =
        fill(collider, surfaces_[s].axis, layout.node_keys, moved ? nullptr : &fields_[s], threads);
    fields_[s].pose = pose;
    fields_[s].shapes = collider.shapes();
  }
}

template <class Real, int D>
auto NodeDistances<Real, D>::fill(const geometry::Collider& collider, int axis,
                                  std::span<const std::uint64_t> keys, const Field* same,
                                  int threads) const -> Field {
  constexpr std::int64_t kGrain = 64;
  const auto blocks = static_cast<std::int64_t>(keys.size());
  const double half = 0.5 * (kBlock - 1) * cell_;
  const double bound =
      lipschitz(collider, axis) * half * std::sqrt(D) + reach_ + kTolerance * cell_;
  Vec3 middle = Vec3::Zero();
  middle.head<D>().setConstant(half);
  Field field;
  auto& of_block = field.of_block;
  of_block.resize(keys.size());
  parallel_for(
      blocks, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          const auto i = usize(b);
          const Vec3 centre = corner<D>(keys[i], cell_) + middle;
          of_block[i] = signed_distance(collider, axis, centre).value <= bound ? 0 : -1;
        }
      },
      threads);
  for (std::size_t b = 0; b < keys.size(); ++b) {
    if (of_block[b] < 0) continue;
    of_block[b] = static_cast<std::int32_t>(field.keys.size());
    field.keys.push_back(keys[b]);
  }
  field.patches = std::vector<Patch>(field.keys.size());
  parallel_for(
      static_cast<std::int64_t>(field.keys.size()), kGrain / 8,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t p = begin; p < end; ++p) {
          const auto i = usize(p);
          const Patch* known = nullptr;
          if (same != nullptr) {
            const auto at = std::lower_bound(same->keys.begin(), same->keys.end(), field.keys[i]);
            if (at != same->keys.end() && *at == field.keys[i]) {
              known = &same->patches[usize(at - same->keys.begin())];
            }
          }
          if (known != nullptr) {
            field.patches[i] = *known;
          } else {
            sample<Real, D>(collider, axis, field.keys[i], cell_, reach_, field.patches[i].values);
          }
        }
      },
      threads);
  return field;
}

template class NodeDistances<float, 2>;
template class NodeDistances<float, 3>;
template class NodeDistances<double, 2>;
template class NodeDistances<double, 3>;

}  // namespace substep::mpm
