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

template <int D>
Vec3 place(std::uint64_t key, int node, double cell) {
  const auto block = transfer::BlockKey<D>::unpack(key);
  Vec3 x = Vec3::Zero();
  for (int d = D - 1, rest = node; d >= 0; --d, rest /= kBlock) {
    x[d] = cell * (static_cast<double>(kBlock) * block[usize(d)] + rest % kBlock);
  }
  return x;
}

template <class Real, int D>
Vec3 velocity_of(const Real* node) {
  Vec3 v = Vec3::Zero();
  for (int d = 0; d < D; ++d) v[d] = static_cast<double>(node[d]);
  return v;
}

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
  walls.begin_step(layout, true, moving(), bodies_.masses(), dt_, threads);
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
  dt_ = dt;
  distances_.update(*layout_, layout_changed_, colliders, threads);
  layout_changed_ = false;
  bodies_.begin(colliders, dt);

  const std::size_t many = colliders.size();
  const auto blocks = static_cast<std::int64_t>(layout_->node_keys.size());
  const auto chunks = usize((blocks + kGrain - 1) / kGrain);
  const auto bound = static_cast<Real>(
      std::min(speed_bound, static_cast<double>(std::numeric_limits<Real>::max())));
  parts_.assign(chunks * many, Exchange{});
  std::vector<Found> found(chunks);
  parallel_for(
      blocks, kGrain,
      [&](std::int64_t begin, std::int64_t end) {
        const auto chunk = usize(begin / kGrain);
        found[chunk] =
            update_blocks(begin, end, nodes.data(), gravity * dt, bound, &parts_[chunk * many]);
      },
      threads);
  const auto good = [](const Found& part) { return part.bad_node < 0; };
  if (bodies_.any() && std::all_of(found.begin(), found.end(), good)) {
    meet_bodies(found, nodes.data(), bound, threads);
  }

  NodeCheck check;
  for (const Found& part : found) {
    check.speed = std::max(check.speed, static_cast<double>(part.speed));
    if (check.good()) check.bad_node = part.bad_node;
  }
  particles_.begin_step(*layout_, false, moving(), bodies_.masses(), dt, threads);
  check.reach = (check.speed + particles_.collider_speed()) * dt / cell_;
  particles_.set_reach(check.reach);
  return check;
}

// A chunk of node blocks; those with nodes in obstacles that yield are left to meet_bodies.
template <class Real, int D>
auto GridUpdate<Real, D>::update_blocks(std::int64_t begin, std::int64_t end, Real* nodes,
                                        const Vec3& gravity_dt, Real bound, Exchange* parts) const
    -> Found {
  constexpr Real kGreatest = std::numeric_limits<Real>::max();
  Found found;
  std::vector<Holder> holders;
  for (std::int64_t b = begin; b < end; ++b) {
    Real* const block = nodes + b * transfer::NodeBlocks<Real, D>::kReals;
    to_velocity<Real, D>(gravity_dt, block);
    find_holders(static_cast<std::int32_t>(b), holders);
    Real limit = bound;
    if (!holders.empty()) {
      // What is not finite must be seen before a condition hides it.
      if (greatest_speed<Real, D>(kGreatest, block) < 0) {
        limit = kGreatest;
      } else if (bodies_.any() && fixed(holders).size() < holders.size()) {
        find_contacts(static_cast<std::int32_t>(b), holders, block, found);
        continue;
      } else {
        hold(static_cast<std::int32_t>(b), holders, block, parts);
      }
    }
    if (!judge(b, limit, block, found)) break;
  }
  return found;
}

// Whether all is well with the velocities of a block.
template <class Real, int D>
bool GridUpdate<Real, D>::judge(std::int64_t node_block, Real limit, const Real* nodes,
                                Found& found) {
  const Real speed = greatest_speed<Real, D>(limit, nodes);
  if (speed < 0) {
    found.bad_node =
        node_block * transfer::NodeBlocks<Real, D>::kNodes + first_bad_node<Real, D>(limit, nodes);
    return false;
  }
  found.speed = std::max(found.speed, speed);
  return true;
}

// Whether a node that a facet holds is nearer to another facet of its surface.
template <class Real, int D>
bool GridUpdate<Real, D>::other_is_nearer(std::span<const Holder> holders, const Holder& holder,
                                          int node) const {
  const int surface = colliders[holder.collider].body.surface;
  if (surface < 0) return false;
  const Real own = holder.patch->values[4 * node + 3];
  return std::any_of(holders.begin(), holders.end(), [&](const Holder& other) {
    const Real theirs = other.patch->values[4 * node + 3];
    return colliders[other.collider].body.surface == surface &&
           (theirs < own || (theirs == own && other.collider < holder.collider));
  });
}

template <class Real, int D>
void GridUpdate<Real, D>::find_contacts(std::int32_t node_block, std::span<const Holder> holders,
                                        const Real* nodes, Found& found) const {
  constexpr int kNodes = transfer::NodeBlocks<Real, D>::kNodes;
  double total = 0;
  std::vector<Holder> held;  // those of a node
  for (int node = 0; node < kNodes; ++node) {
    const Real* const at = nodes + node * kNodeReals;
    const std::size_t first = found.contacts.size();
    total += static_cast<double>(at[D]);
    held.clear();
    if (at[D] < kEmpty<Real>) continue;
    for (const Holder& holder : holders) {
      if (holder.patch->values[4 * node + 3] <= 0) held.push_back(holder);
    }
    for (const Holder& holder : held) {
      const Collider& collider = moving()[holder.collider];
      const Real* const n = holder.patch->values + 4 * node;
      if (!collider.yields() || other_is_nearer(held, holder, node)) continue;
      Vec3 arm = place<D>(layout_->node_keys[usize(node_block)], node, cell_) - collider.centre();
      if constexpr (D == 2) arm[2] = 0;
      found.contacts.push_back({holder.collider, std::int64_t{node_block} * kNodes + node,
                                static_cast<double>(at[D]), arm, velocity_of<Real, D>(at),
                                Vec3(n[0], n[1], n[2]), boundaries_[holder.collider],
                                collider.friction});
    }
    const auto many = static_cast<double>(found.contacts.size() - first);
    for (std::size_t k = first; k < found.contacts.size(); ++k) found.contacts[k].mass /= many;
  }
  found.masses.resize(colliders.size());
  for (const Holder& holder : holders) found.masses[holder.collider] += total;
  found.met.push_back(node_block);
}

// Gives nodes and bodies what they exchange; other obstacles in the same blocks come after that.
template <class Real, int D>
void GridUpdate<Real, D>::meet_bodies(std::vector<Found>& found, Real* nodes, Real bound,
                                      int threads) {
  std::vector<BodyContact*> contacts;
  std::vector<double> masses(colliders.size());
  for (Found& part : found) {
    for (BodyContact& contact : part.contacts) contacts.push_back(&contact);
    for (std::size_t c = 0; c < part.masses.size(); ++c) masses[c] += part.masses[c];
  }
  bodies_.meet(contacts, masses, threads);
  parallel_chunks(
      static_cast<std::int64_t>(found.size()),
      [&](std::int64_t chunk) {
        Found& part = found[usize(chunk)];
        for (const BodyContact& contact : part.contacts) {
          Real* const at = nodes + contact.node * kNodeReals;
          for (int d = 0; d < D; ++d) {
            at[d] += static_cast<Real>(contact.impulse[d] / static_cast<double>(at[D]));
          }
        }
        std::vector<Holder> holders;
        for (const std::int32_t b : part.met) {
          Real* const block = nodes + b * std::int64_t{transfer::NodeBlocks<Real, D>::kReals};
          find_holders(b, holders);
          const std::span<const Holder> others = fixed(holders);
          if (!others.empty()) hold(b, others, block, &parts_[usize(chunk) * colliders.size()]);
          if (!judge(b, bound, block, part)) break;
        }
      },
      threads);
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
  for (const auto& held : distances_.held(node_block)) {
    holders.push_back({distances_.all()[usize(held.surface)].collider, &distances_.patch(held)});
  }
}

// Those that do not yield; they come first then.
template <class Real, int D>
auto GridUpdate<Real, D>::fixed(std::vector<Holder>& holders) const -> std::span<const Holder> {
  const auto end = std::stable_partition(holders.begin(), holders.end(), [&](const Holder& holder) {
    return !colliders[holder.collider].yields();
  });
  return {holders.begin(), end};
}

// Nodes at several surfaces take their conditions in turn, until none changes anything: at an edge
// between two walls that is a node that moves along both.
template <class Real, int D>
void GridUpdate<Real, D>::hold(std::int32_t node_block, std::span<const Holder> holders,
                               Real* nodes, Exchange* parts) const {
  constexpr int kSweeps = 32;
  constexpr double kUnchanged = 1e-14;  // of the squared velocity
  const std::vector<Collider>& moved = moving();
  for (int node = 0; node < transfer::NodeBlocks<Real, D>::kNodes; ++node) {
    const auto holds = [&](const Holder& holder) {
      return holder.patch->values[4 * node + 3] <= 0;
    };
    Real* const at = nodes + node * kNodeReals;
    const auto mass = static_cast<double>(at[D]);
    if (at[D] < kEmpty<Real> || std::none_of(holders.begin(), holders.end(), holds)) continue;
    Vec3 v = velocity_of<Real, D>(at);
    const Vec3 x = place<D>(layout_->node_keys[usize(node_block)], node, cell_);
    bool changed = true;
    for (int sweep = 0; sweep < kSweeps && changed; ++sweep) {
      changed = false;
      for (const Holder& holder : holders) {
        if (!holds(holder)) continue;
        const Collider& collider = moved[holder.collider];
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
  const std::span<const Exchange> from_particles = particles_.sum_exchanges();
  for (std::size_t c = 0; c < many; ++c) {
    Exchange sum = colliders[c].exchange();
    for (std::size_t part = c; part < parts_.size(); part += many) sum += parts_[part];
    if (bodies_.any() && colliders[c].yields()) {
      const Collider& body = bodies_.moving()[c];
      sum += body.exchange();
      colliders[c].velocity = body.velocity;
      colliders[c].angular_velocity = body.angular_velocity;
      colliders[c].body.received = body.body.received;
    }
    sum += from_particles[c];
    colliders[c].set_exchange(sum);
    colliders[c].advance(dt_);
  }
  for (std::size_t c = 0; c < many; ++c) {
    if (colliders[c].yields()) push_body(colliders, c, from_particles[c]);
  }
  bodies_.end();
  return particles_.excess();
}

template class GridUpdate<float, 2>;
template class GridUpdate<float, 3>;
template class GridUpdate<double, 2>;
template class GridUpdate<double, 3>;

}  // namespace substep::mpm
