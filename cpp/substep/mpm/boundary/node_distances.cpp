#include "substep/mpm/boundary/node_distances.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/bounding_balls.h"
#include "substep/geometry/surely_beyond.h"

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
  const auto beyond = [&](const Vec3& x, double far) {
    const Vec3 local = collider.rotation().transpose() * (x - collider.position());
    return geometry::surely_beyond(collider, local, far);
  };
  for (int group = 0; group < 1 << D; ++group) {
    Vec3 centre = first;
    for (int d = 0; d < D; ++d) centre[d] += cell * (kHalf * (group >> d & 1) + 0.5);
    const bool free =
        beyond(centre, clear) || signed_distance(collider, axis, centre).value > clear;
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
      if (free || beyond(x, near)) continue;
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
  std::vector<std::uint8_t> anew(surfaces_.size(), 0);
  std::vector<Field> before(surfaces_.size());  // whose patches hold
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    const geometry::Collider& collider = colliders[surfaces_[s].collider];
    const auto state = collider.state();
    Field field;
    std::copy_n(state.begin(), kPose, field.pose.begin());
    field.shapes = collider.shapes();
    const bool moved = field.pose != fields_[s].pose || field.shapes != fields_[s].shapes;
    if (!moved && !layout_changed) continue;
    anew[s] = 1;
    if (!moved) before[s] = std::move(fields_[s]);
    fields_[s] = std::move(field);
  }
  if (!layout_changed && std::find(anew.begin(), anew.end(), 1) == anew.end()) return;
  try {
    find_blocks(layout.node_keys, colliders, anew, threads);
    fill(colliders, anew, before, threads);
    list_held(layout.node_keys.size());
  } catch (...) {
    fields_.clear();  // the next call finds all anew
    throw;
  }
}

template <class Real, int D>
void NodeDistances<Real, D>::find_blocks(std::span<const std::uint64_t> keys,
                                         std::span<const geometry::Collider> colliders,
                                         std::span<const std::uint8_t> anew, int threads) {
  constexpr std::int64_t kGrain = 64;
  const auto blocks = static_cast<std::int64_t>(keys.size());
  const double half = 0.5 * (kBlock - 1) * cell_, near = reach_ + kTolerance * cell_;
  Vec3 middle = Vec3::Zero();
  middle.head<D>().setConstant(half);
  std::vector<std::int32_t> asked;  // surfaces
  geometry::BoundingBalls balls;
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    if (anew[s] == 0) continue;
    asked.push_back(static_cast<std::int32_t>(s));
    balls.add(colliders[surfaces_[s].collider]);
  }
  std::vector<std::vector<std::pair<std::int32_t, std::int32_t>>> found(  // surface, block
      usize((blocks + kGrain - 1) / kGrain));
  parallel_for(
      blocks, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<std::int32_t> close;
        for (std::int64_t b = begin; b < end; ++b) {
          const Vec3 centre = corner<D>(keys[usize(b)], cell_) + middle;
          balls.find(centre, half * std::sqrt(D) + near, close);
          for (const std::int32_t k : close) {
            const auto [c, axis] = surfaces_[usize(asked[usize(k)])];
            const double bound = lipschitz(colliders[c], axis) * half * std::sqrt(D) + near;
            if (!(signed_distance(colliders[c], axis, centre).value <= bound)) continue;
            found[usize(begin / kGrain)].emplace_back(asked[usize(k)], b);
          }
        }
      },
      threads);
  for (const auto& part : found) {
    for (const auto& [s, b] : part) {
      fields_[usize(s)].keys.push_back(keys[usize(b)]);
      fields_[usize(s)].blocks.push_back(b);
    }
  }
}

template <class Real, int D>
void NodeDistances<Real, D>::fill(std::span<const geometry::Collider> colliders,
                                  std::span<const std::uint8_t> anew, std::span<Field> before,
                                  int threads) {
  constexpr std::int64_t kGrain = 8;
  std::vector<std::pair<std::size_t, std::size_t>> lacking;  // surface, patch
  for (std::size_t s = 0; s < surfaces_.size(); ++s) {
    if (anew[s] == 0) continue;
    Field &field = fields_[s], &known = before[s];
    field.patches = std::vector<Patch>(field.keys.size());
    for (std::size_t p = 0, k = 0; p < field.keys.size(); ++p) {
      while (k < known.keys.size() && known.keys[k] < field.keys[p]) ++k;
      if (k < known.keys.size() && known.keys[k] == field.keys[p]) {
        field.patches[p] = known.patches[k];
      } else {
        lacking.emplace_back(s, p);
      }
    }
  }
  parallel_for(
      static_cast<std::int64_t>(lacking.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t k = begin; k < end; ++k) {
          const auto [s, p] = lacking[usize(k)];
          const auto [c, axis] = surfaces_[s];
          sample<Real, D>(colliders[c], axis, fields_[s].keys[p], cell_, reach_,
                          fields_[s].patches[p].values);
        }
      },
      threads);
}

template <class Real, int D>
void NodeDistances<Real, D>::list_held(std::size_t blocks) {
  starts_.assign(blocks + 1, 0);
  for (const Field& field : fields_) {
    for (const std::int32_t b : field.blocks) ++starts_[usize(b) + 1];
  }
  for (std::size_t b = 0; b < blocks; ++b) starts_[b + 1] += starts_[b];
  held_.resize(usize(starts_[blocks]));
  std::vector<std::int32_t> next(starts_.begin(), starts_.end() - 1);
  for (std::size_t s = 0; s < fields_.size(); ++s) {
    for (std::size_t p = 0; p < fields_[s].blocks.size(); ++p) {
      held_[usize(next[usize(fields_[s].blocks[p])]++)] = {static_cast<std::int32_t>(s),
                                                           static_cast<std::int32_t>(p)};
    }
  }
}

template class NodeDistances<float, 2>;
template class NodeDistances<float, 3>;
template class NodeDistances<double, 2>;
template class NodeDistances<double, 3>;

}  // namespace substep::mpm
