#include "substep/mpm/passes/grid_update.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "substep/core/lanes.h"
#include "substep/core/parallel.h"
#include "substep/core/usize.h"

namespace substep::mpm {
namespace {

using geometry::Collider;
using geometry::Exchange;
using geometry::Vec3;
using transfer::kBlock;
using transfer::kNodeReals;

// Whole nodes, at least one.
template <class Real>
inline constexpr int kBytes = std::max(kVectorBytes, kNodeReals* static_cast<int>(sizeof(Real)));
template <class Real>
using NodeRow = Vector<Real, kBytes<Real>>;
template <class Real>
inline constexpr int kReals = kBytes<Real> / static_cast<int>(sizeof(Real));

// A mass below that carries no digits of its momentum.
template <class Real>
inline constexpr Real kEmpty = std::numeric_limits<Real>::min();

// The mass of each lane's node.
template <int D, class V, int... kLane>
SUBSTEP_INLINE V masses(const V& nodes, std::integer_sequence<int, kLane...>) {
  return __builtin_shufflevector(nodes, nodes, (kLane / kNodeReals * kNodeReals + D)...);
}

// a in the lanes of velocities, b in the others.
template <int D, class V>
SUBSTEP_INLINE V in_velocity_lanes(const V& a, const V& b) {
  IntOf<Lane<V>> lanes[sizeof(V) / sizeof(a[0])];
  for (int l = 0; l < static_cast<int>(sizeof(V) / sizeof(a[0])); ++l) {
    lanes[l] = l % kNodeReals < D ? -1 : 0;
  }
  return load<Vector<IntOf<Lane<V>>, sizeof(V)>>(lanes) ? a : b;
}

// v = p / m + g dt for the nodes of a block; 0 where there is no mass.
template <class Real, int D>
void to_velocity(const Vec3& gravity_dt, Real* nodes) {
  using V = NodeRow<Real>;
  Real lanes[kReals<Real>];
  for (int l = 0; l < kReals<Real>; ++l) {
    lanes[l] = l % kNodeReals < D ? static_cast<Real>(gravity_dt[l % kNodeReals]) : 0;
  }
  const V g = load<V>(lanes);
  for (int i = 0; i < transfer::NodeBlocks<Real, D>::kReals; i += kReals<Real>) {
    const V node = load<V>(nodes + i);
    const V m = masses<D>(node, std::make_integer_sequence<int, kReals<Real>>{});
    const auto empty = m < kEmpty<Real>;
    const V v = node / (empty ? splat<V>(1) : m) + g;
    const V result = in_velocity_lanes<D>(empty ? node * 0 : v, node);  // NaN stays NaN
    std::copy_n(reinterpret_cast<const Real*>(&result), kReals<Real>, nodes + i);
  }
}

// The greatest component of the velocities of a block, -1 if one is above the bound or not finite.
template <class Real, int D>
Real greatest_speed(Real bound, const Real* nodes) {
  using V = NodeRow<Real>;
  V greatest{};
  auto bad = greatest > greatest;
  for (int i = 0; i < transfer::NodeBlocks<Real, D>::kReals; i += kReals<Real>) {
    const V v = in_velocity_lanes<D>(load<V>(nodes + i), V{});
    const V speed = v < 0 ? -v : v;
    bad |= ~(speed <= bound);
    greatest = speed > greatest ? speed : greatest;
  }
  if (any(bad)) return -1;
  Real result = 0;
  for (int l = 0; l < kReals<Real>; ++l) result = std::max(result, greatest[l]);
  return result;
}

template <class Real, int D>
int first_bad_node(Real bound, const Real* nodes) {
  for (int node = 0;; ++node) {
    for (int d = 0; d < D; ++d) {
      if (!(std::abs(nodes[node * kNodeReals + d]) <= bound)) return node;
    }
  }
}

// What a task found in its chunk of node blocks.
template <class Real>
struct Found {
  Real speed = 0;
  std::int64_t bad_node = -1;
};

}  // namespace

template <class Real, int D>
GridUpdate<Real, D>::GridUpdate(double cell, std::vector<Collider> obstacles,
                                std::vector<Boundary> boundaries, double reach)
    : colliders(std::move(obstacles)),
      cell_(cell),
      boundaries_(std::move(boundaries)),
      distances_(cell, reach),
      particles_(cell, boundaries_) {}

template <class Real, int D>
ParticleBoundary<Real, D> GridUpdate<Real, D>::walls_of(const transfer::BlockLayout<D>& layout,
                                                        int threads) const {
  ParticleBoundary<Real, D> walls(cell_, boundaries_);
  walls.begin_step(layout, true, colliders, dt_, threads);
  walls.set_reach(particles_.reach());
  return walls;
}

template <class Real, int D>
void GridUpdate<Real, D>::set_layout(const transfer::BlockLayout<D>& layout,
                                     ParticleBoundary<Real, D>&& walls) noexcept {
  layout_ = &layout;
  layout_changed_ = true;
  particles_ = std::move(walls);
}

template <class Real, int D>
NodeCheck GridUpdate<Real, D>::update(std::span<Real> nodes, const Vec3& gravity, double dt,
                                      double speed_bound, int threads) {
  constexpr int kNodes = transfer::NodeBlocks<Real, D>::kNodes;
  constexpr Real kGreatest = std::numeric_limits<Real>::max();
  dt_ = dt;
  distances_.update(*layout_, layout_changed_, colliders, threads);
  layout_changed_ = false;

  const std::size_t many = colliders.size();
  const auto blocks = static_cast<std::int64_t>(layout_->node_keys.size());
  const auto chunks = usize((blocks + kGrain - 1) / kGrain);
  const auto bound = static_cast<Real>(std::min(speed_bound, static_cast<double>(kGreatest)));
  parts_.assign(chunks * many, Exchange{});
  std::vector<Found<Real>> found(chunks);
  parallel_for(
      blocks, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        const auto chunk = usize(begin / kGrain);
        std::vector<Holder> holders;
        for (std::int64_t b = begin; b < end; ++b) {
          Real* block = nodes.data() + b * kNodes * kNodeReals;
          to_velocity<Real, D>(gravity * dt, block);
          find_holders(static_cast<std::int32_t>(b), holders);
          Real limit = bound;
          if (!holders.empty()) {
            // What is not finite must be seen before a condition hides it.
            if (greatest_speed<Real, D>(kGreatest, block) < 0) {
              limit = kGreatest;
            } else {
              hold(static_cast<std::int32_t>(b), holders, block, &parts_[chunk * many]);
            }
          }
          const Real speed = greatest_speed<Real, D>(limit, block);
          if (speed < 0) {
            found[chunk].bad_node = b * kNodes + first_bad_node<Real, D>(limit, block);
            break;
          }
          found[chunk].speed = std::max(found[chunk].speed, speed);
        }
      },
      threads);

  NodeCheck check;
  for (const Found<Real>& part : found) {
    check.speed = std::max(check.speed, static_cast<double>(part.speed));
    if (check.good()) check.bad_node = part.bad_node;
  }
  particles_.begin_step(*layout_, false, colliders, dt, threads);
  check.reach = (check.speed + particles_.collider_speed()) * dt / cell_;
  particles_.set_reach(check.reach);
  return check;
}

template <class Real, int D>
void GridUpdate<Real, D>::hold(std::span<Real> nodes, int threads) const {
  parallel_for(
      static_cast<std::int64_t>(layout_->node_keys.size()), kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        std::vector<Holder> holders;
        std::vector<Exchange> unused(colliders.size());
        for (std::int64_t b = begin; b < end; ++b) {
          Real* block = nodes.data() + b * transfer::NodeBlocks<Real, D>::kReals;
          find_holders(static_cast<std::int32_t>(b), holders);
          if (!holders.empty()) hold(static_cast<std::int32_t>(b), holders, block, unused.data());
        }
      },
      threads);
}

template <class Real, int D>
void GridUpdate<Real, D>::find_holders(std::int32_t node_block,
                                       std::vector<Holder>& holders) const {
  holders.clear();
  for (std::size_t s = 0; s < distances_.all().size(); ++s) {
    const auto* patch = distances_.patch(s, node_block);
    if (patch != nullptr) holders.push_back({distances_.all()[s].collider, patch});
  }
}

// Nodes at several surfaces take their conditions in turn, until none changes anything: at an edge
// between two walls that is a node that moves along both.
template <class Real, int D>
void GridUpdate<Real, D>::hold(std::int32_t node_block, std::span<const Holder> holders,
                               Real* nodes, Exchange* parts) const {
  constexpr int kSweeps = 32;
  constexpr double kUnchanged = 1e-14;  // of the squared velocity
  const auto key = layout_->node_keys[usize(node_block)];
  const auto block = transfer::BlockKey<D>::unpack(key);
  for (int node = 0; node < transfer::NodeBlocks<Real, D>::kNodes; ++node) {
    const auto holds = [&](const Holder& holder) {
      return holder.patch->values[4 * node + 3] <= 0;
    };
    Real* const at = nodes + node * kNodeReals;
    const auto mass = static_cast<double>(at[D]);
    if (at[D] < kEmpty<Real> || std::none_of(holders.begin(), holders.end(), holds)) continue;
    Vec3 v = Vec3::Zero(), x = Vec3::Zero();
    for (int d = D - 1, rest = node; d >= 0; --d, rest /= kBlock) {
      v[d] = static_cast<double>(at[d]);
      x[d] = cell_ * (static_cast<double>(kBlock) * block[usize(d)] + rest % kBlock);
    }
    bool changed = true;
    for (int sweep = 0; sweep < kSweeps && changed; ++sweep) {
      changed = false;
      for (const Holder& holder : holders) {
        if (!holds(holder)) continue;
        const Collider& collider = colliders[holder.collider];
        const Real* n = holder.patch->values + 4 * node;
        Vec3 surface = collider.surface_velocity(x);
        if constexpr (D == 2) surface[2] = 0;
        const Vec3 after = conditioned(v, surface, Vec3(n[0], n[1], n[2]),
                                       boundaries_[holder.collider], collider.friction);
        const Vec3 jump = after - v;
        if (!(jump.squaredNorm() > kUnchanged * after.squaredNorm())) continue;
        parts[holder.collider].add(x - collider.position(), -mass * jump);
        v = after;
        changed = holders.size() > 1;
      }
    }
    for (int d = 0; d < D; ++d) at[d] = static_cast<Real>(v[d]);
  }
}

template <class Real, int D>
void GridUpdate<Real, D>::clear_exchange() {
  for (Collider& collider : colliders) collider.set_exchange({});
}

template <class Real, int D>
double GridUpdate<Real, D>::finish() {
  const std::size_t many = colliders.size();
  for (std::size_t c = 0; c < many; ++c) {
    Exchange sum = colliders[c].exchange();
    for (std::size_t part = c; part < parts_.size(); part += many) sum += parts_[part];
    sum += particles_.exchange(c);
    colliders[c].set_exchange(sum);
    colliders[c].advance(dt_);
  }
  return particles_.excess();
}

template class GridUpdate<float, 2>;
template class GridUpdate<float, 3>;
template class GridUpdate<double, 2>;
template class GridUpdate<double, 3>;

}  // namespace substep::mpm
