#include "substep/mpm/general/general.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/mpm/boundary/particle_boundary.h"
#include "substep/mpm/general/materials.h"
#include "substep/mpm/general/stencil.h"
#include "substep/mpm/particles/particle_loop.h"
#include "substep/mpm/passes/scatter_blocks.h"
#include "substep/transfer/weights.h"

namespace substep::mpm {

namespace {

double inverse_moment(int order) {  // D^-1 [1/cell^2]
  return 1 / (order == 2 ? transfer::kSecondMoment<2> : transfer::kSecondMoment<3>);
}

template <class V>
void store(Lane<V>* lanes, const V& value) {
  std::memcpy(lanes, &value, sizeof value);
}

// The velocity gradient of a packet from `rows`, entry (i, j) of all lanes together.
template <class Real, int D>
Tensor<Vector<Real>, D> load_gradient(const Real* rows) {
  Tensor<Vector<Real>, D> G{};
  for (int k = 0; k < D * D; ++k) G(k / D, k % D) = load<Vector<Real>>(rows + k * kLanes<Real>);
  return G;
}

// m v, m C and the impulses of the stress of one packet, for a step of dt.
template <class Real, int D>
void packet_momenta(const Scheme& scheme, const Particles<Real, D>& particles, std::size_t g,
                    std::int64_t packet, double dt, PacketMomenta<Real, D>& to) {
  using V = Vector<Real>;
  const ParticleGroup<Real, D>& group = particles.groups[g];
  const AnyMaterial& material = particles.materials[g];
  const double dx = particles.cell;
  const Real* v = group.motion(packet);
  const auto C = load_gradient<Real, D>(v + D * kLanes<Real>);
  SymmetricTensor<V, D> tau;
  packet_stress<Real, D>(material, group.packet(packet) + D * kLanes<Real>, C,
                         Real(particles.before), tau);

  const V volume = load<V>(group.volume.data() + packet * kLanes<Real>);
  const V mass = volume * Real(density(material));
  const bool apic = is_affine(scheme.transfer);
  const V mass_dx = mass * Real(apic ? dx : 0);  // arms are in cells
  const V impulse = volume * Real(-dt / dx);     // and so are gradients
  const V mls = uses_gradients(scheme) ? V{} : V(impulse * Real(inverse_moment(scheme.order)));
  store(to.p[D], mass);
  for (int i = 0; i < D; ++i) {
    store(to.p[i], mass * load<V>(v + i * kLanes<Real>));
    for (int j = 0; j < D; ++j) {
      store(to.A[i][j], fma(mass_dx, C(i, j), mls * tau(i, j)));
      store(to.T[i][j], impulse * tau(i, j));
    }
  }
}

// The same without the impulses.
template <class Real, int D>
void own_momenta(const Particles<Real, D>& particles, std::size_t g, std::int64_t packet,
                 PacketMomenta<Real, D>& to) {
  using V = Vector<Real>;
  const ParticleGroup<Real, D>& group = particles.groups[g];
  const auto C = load_gradient<Real, D>(group.motion(packet) + D * kLanes<Real>);
  const V mass_dx = load<V>(group.volume.data() + packet * kLanes<Real>) *
                    Real(density(particles.materials[g]) * particles.cell);
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) {
      store(to.A[i][j], V(mass_dx * C(i, j)));
      store(to.T[i][j], V{});
    }
  }
}

// v_i^before of the nodes of a block: momentum becomes velocity.
template <class Real, int D>
void copy_before(const Nodes<Real, D>& before, const transfer::BlockLayout<D>& layout,
                 std::size_t block, Arena<Real, D>& arena) {
  arena.copy(before, layout, block);
  for (Real* node = arena.nodes; node < arena.nodes + arena.kReals; node += transfer::kNodeReals) {
    const Real inverse = node[D] < std::numeric_limits<Real>::min() ? 0 : 1 / node[D];
    for (int d = 0; d < D; ++d) node[d] *= inverse;
  }
}

// m v and m C of one packet, and 1 in the place of the mass: m_i is known, the share s_i is not.
template <class Real, int D>
void new_momenta(const Particles<Real, D>& particles, std::size_t g, std::int64_t packet,
                 PacketMomenta<Real, D>& to) {
  using V = Vector<Real>;
  const ParticleGroup<Real, D>& group = particles.groups[g];
  const Real* v = group.motion(packet);
  const auto C = load_gradient<Real, D>(v + D * kLanes<Real>);
  const V mass =
      load<V>(group.volume.data() + packet * kLanes<Real>) * Real(density(particles.materials[g]));
  store(to.p[D], splat<V>(Real(1)));
  for (int i = 0; i < D; ++i) {
    store(to.p[i], mass * load<V>(v + i * kLanes<Real>));
    for (int j = 0; j < D; ++j) store(to.A[i][j], V(mass * Real(particles.cell) * C(i, j)));
  }
}

// v'' of a node block, from v and m_i, and m_i v' and the sum of the weights.
template <class Real, int D>
void mix(bool apic, const Real* nodes, Real* after) {
  const Real* const end = nodes + transfer::NodeBlocks<Real, D>::kReals;
  for (; nodes < end; nodes += transfer::kNodeReals, after += transfer::kNodeReals) {
    const Real mass = nodes[D], share = apic ? std::min(Real(1), after[D]) : 0;
    const bool empty = mass < std::numeric_limits<Real>::min();
    for (int d = 0; d < D; ++d) {
      const Real v = empty ? 0 : after[d] / mass;
      after[d] = v + share * (nodes[d] - v);
    }
    after[D] = mass;
  }
}

// The lanes after the last particle of a packet repeat it.
template <class Real, int D>
void repeat_last(int count, PacketVelocities<Real, D>& packet) {
  Real* rows[] = {packet.v[0], packet.C[0][0], packet.G[0][0], packet.mass};
  const int numbers[] = {D, D * D, D * D, 1};
  for (int k = 0; k < 4; ++k) {
    for (int n = 0; n < numbers[k]; ++n) {
      Real* row = rows[k] + n * kLanes<Real>;
      for (int lane = count; lane < kLanes<Real>; ++lane) row[lane] = row[count - 1];
    }
  }
}

// The share of FLIP in a step of dt.
template <class Real>
Real flip_share(const Scheme& scheme, double dt) {
  return Real(std::exp(-scheme.flip_rate * dt));
}

// New v of a packet: `moved` as the grid is now, for FLIP with a share of what v was above that of
// the grid before.
template <class Real, int D>
void set_velocity(const Scheme& scheme, Real share, const PacketVelocities<Real, D>& moved,
                  const PacketVelocities<Real, D>& old, Real* v) {
  using V = Vector<Real>;
  for (int i = 0; i < D; ++i, v += kLanes<Real>) {
    V velocity = load<V>(moved.v[i]);
    if (keeps_change(scheme.transfer)) velocity += (load<V>(v) - load<V>(old.v[i])) * share;
    store(v, velocity);
  }
}

// For AFLIP: C keeps `share` of the antisymmetric part that the grid did not see before.
template <class Real, int D>
void keep_spin(Real share, Real per_cell, const PacketVelocities<Real, D>& from,
               const PacketVelocities<Real, D>& before, Real* C) {
  using V = Vector<Real>;
  constexpr int kWidth = kLanes<Real>;
  for_each_spin<D>([&](int, int i, int j) {
    Real *const ij = C + (i * D + j) * kWidth, *const ji = C + (j * D + i) * kWidth;
    const V seen = (load<V>(before.C[i][j]) - load<V>(before.C[j][i])) * per_cell;
    const V unseen = share * Real(0.5) * (load<V>(ij) - load<V>(ji) - seen);
    store(ij, V(load<V>(from.C[i][j]) * per_cell + unseen));
    store(ji, V(load<V>(from.C[j][i]) * per_cell - unseen));
  });
}

// New C, x and fields of one packet of a block, whose v is new; divergence [per cell] of the lanes,
// or none; what the grid saw before, where C keeps what it did not, or none.
template <class Real, int D>
void advance_packet(const Scheme& scheme, Particles<Real, D>& particles, std::int32_t block,
                    std::size_t g, std::int64_t packet, int count, double dt,
                    const PacketVelocities<Real, D>& from, const Real* divergence,
                    const PacketVelocities<Real, D>* before) {
  using V = Vector<Real>;
  constexpr int kWidth = kLanes<Real>;
  ParticleGroup<Real, D>& group = particles.groups[g];
  const AnyMaterial& material = particles.materials[g];
  const Real per_cell = Real(1 / particles.cell);
  Real *x = group.packet(packet), *v = group.motion(packet), *C = v + D * kWidth;
  alignas(64) Real from_x[D * kWidth];
  std::memcpy(from_x, x, sizeof from_x);
  const bool gradients = scheme.form == Form::kTextbook && scheme.order != 1;
  const auto& G = gradients ? from.G : from.C;
  const auto& stored = is_affine(scheme.transfer) ? from.C : G;
  Tensor<V, D> gradient{};
  if (before != nullptr) keep_spin(flip_share<Real>(scheme, dt), per_cell, from, *before, C);
  for (int i = 0; i < D; ++i) {
    store(x + i * kWidth,
          fma(Real(dt) * per_cell, load<V>(from.v[i]), load<V>(from_x + i * kWidth)));
    for (int j = 0; j < D; ++j) {
      if (i == j || before == nullptr) {
        store(C + (i * D + j) * kWidth, V(load<V>(stored[i][j]) * per_cell));
      }
      gradient(i, j) = load<V>(G[i][j]) * per_cell;
    }
  }
  if (divergence != nullptr) {
    gradient = with_divergence<V, D>(gradient, load<V>(divergence) * per_cell);
  }
  if (particles.walls && particles.walls->near(block)) {
    particles.walls->settle(block, from_x, x, v, group.volume.data() + packet * kWidth,
                            density(material), count);
  }
  packet_advance<Real, D>(material, x + D * kWidth, particles.trial, Real(particles.before),
                          gradient, Real(dt), load<V>(from.mass) * power<D>(per_cell));
}

}  // namespace

template <class Real, int D>
void p2g(const Scheme& scheme, const Particles<Real, D>& particles, double dt,
         Nodes<Real, D>& nodes, Nodes<Real, D>& before, int threads) {
  const auto& layout = particles.layout;
  const bool flip = keeps_change(scheme.transfer), apic = is_affine(scheme.transfer);
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, uses_gradients(scheme));
  if (flip) before.set_zero(layout.node_blocks(), threads);
  scatter_blocks<Real, D>(layout, nodes, threads, [&](std::size_t block, Arena<Real, D>& arena) {
    Arena<Real, D> plain;
    PacketMomenta<Real, D> momenta;
    if (flip) plain.set_zero();
    for_packets_of_block(particles, static_cast<std::int32_t>(block),
                         [&](std::size_t g, std::int64_t packet, std::int32_t, int count) {
                           const Real* x = particles.groups[g].packet(packet);
                           packet_momenta(scheme, particles, g, packet, dt, momenta);
                           stencil.scatter(x, count, momenta, arena);
                           if (!flip) return;
                           if (apic) {
                             own_momenta(particles, g, packet, momenta);
                             stencil.scatter(x, count, momenta, plain);
                           } else {
                             stencil.scatter_values(x, count, momenta, plain);
                           }
                         });
    if (flip) plain.add_to(before, layout, block);
  });
}

template <class Real, int D>
double greatest_speed(const Scheme& scheme, const Particles<Real, D>& particles,
                      const Nodes<Real, D>& nodes, int threads) {
  const auto& layout = particles.layout;
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, false);
  std::vector<Real> greatest(usize(layout.blocks()));
  parallel_chunks(
      layout.blocks(),
      [&](std::int64_t block) {
        Arena<Real, D> arena;
        PacketVelocities<Real, D> velocities;
        const auto b = usize(block);
        arena.copy(nodes, layout, b);
        Real most = 0;
        for_packets_of_block(particles, static_cast<std::int32_t>(block),
                             [&](std::size_t g, std::int64_t packet, std::int32_t, int count) {
                               stencil.gather_values(particles.groups[g].packet(packet), count,
                                                     arena, velocities);
                               for (const auto& row : velocities.v) {
                                 for (int lane = 0; lane < count; ++lane) {
                                   most = std::max(most, std::abs(row[lane]));
                                 }
                               }
                             });
        greatest[b] = most;
      },
      threads);
  return greatest.empty() ? 0 : double(*std::max_element(greatest.begin(), greatest.end()));
}

template <class Real, int D>
void remap(const Scheme& scheme, Particles<Real, D>& particles, double dt,
           const Nodes<Real, D>& nodes, const Nodes<Real, D>& before, Nodes<Real, D>& after,
           int threads) {
  const auto& layout = particles.layout;
  const bool flip = keeps_change(scheme.transfer), apic = is_affine(scheme.transfer);
  const Real share = flip_share<Real>(scheme, dt);
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, uses_gradients(scheme));
  scatter_blocks<Real, D>(layout, after, threads, [&](std::size_t b, Arena<Real, D>& sum) {
    Arena<Real, D> arena, plain;
    PacketVelocities<Real, D> moved, old;
    PacketMomenta<Real, D> momenta{};
    arena.copy(nodes, layout, b);
    if (flip) copy_before(before, layout, b, plain);
    for_packets_of_block(particles, static_cast<std::int32_t>(b),
                         [&](std::size_t g, std::int64_t packet, std::int32_t, int count) {
                           const Real* x = particles.groups[g].packet(packet);
                           Real* v = particles.groups[g].motion(packet);
                           stencil.gather_values(x, count, arena, moved);
                           repeat_last<Real, D>(count, moved);
                           if (flip) {
                             stencil.gather_values(x, count, plain, old);
                             repeat_last<Real, D>(count, old);
                           }
                           set_velocity(scheme, share, moved, old, v);
                           new_momenta(particles, g, packet, momenta);
                           (apic ? stencil.scatter : stencil.scatter_values)(x, count, momenta,
                                                                             sum);
                           // g2p finds in C by what velocity they move.
                           std::memcpy(v + D * kLanes<Real>, moved.v, sizeof moved.v);
                         });
  });
  parallel_chunks(
      layout.node_blocks(),
      [&](std::int64_t b) { mix<Real, D>(apic, nodes.block(b), after.block(b)); }, threads);
}

template <class Real, int D>
void g2p(const Scheme& scheme, Particles<Real, D>& particles, double dt,
         const Nodes<Real, D>& nodes, const Nodes<Real, D>& before, int threads) {
  const auto& layout = particles.layout;
  const bool flip = keeps_change(scheme.transfer) && !scheme.musl;
  const bool affine = is_affine(scheme.transfer);
  const Real share = flip_share<Real>(scheme, dt);
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, uses_gradients(scheme));
  parallel_chunks(
      layout.blocks(),
      [&](std::int64_t block) {
        Arena<Real, D> arena, plain;
        PacketVelocities<Real, D> velocities, old;
        alignas(64) Real divergence[kLanes<Real>];
        const auto b = usize(block);
        arena.copy(nodes, layout, b);
        if (flip) copy_before(before, layout, b, plain);
        for_packets_of_block(
            particles, static_cast<std::int32_t>(block),
            [&](std::size_t g, std::int64_t packet, std::int32_t at, int count) {
              const Real* x = particles.groups[g].packet(packet);
              Real* v = particles.groups[g].motion(packet);
              stencil.gather(x, count, arena, velocities);
              repeat_last<Real, D>(count, velocities);
              if (flip) {
                (affine ? stencil.gather : stencil.gather_values)(x, count, plain, old);
                repeat_last<Real, D>(count, old);
              }
              if (scheme.musl) {
                std::memcpy(velocities.v, v + D * kLanes<Real>, sizeof velocities.v);
              } else {
                set_velocity(scheme, share, velocities, old, v);
              }
              const bool averages = scheme.averages && averages_volume(particles.materials[g]);
              if (averages) {
                stencil.divergence(x, count, arena, divergence);
                std::fill(divergence + count, divergence + kLanes<Real>, divergence[count - 1]);
              }
              advance_packet(scheme, particles, at, g, packet, count, dt, velocities,
                             averages ? divergence : nullptr, flip && affine ? &old : nullptr);
            });
      },
      threads);
  particles.trial = true;
  particles.before = dt;
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                              \
  template void p2g(const Scheme&, const Particles<Real, D>&, double, Nodes<Real, D>&,            \
                    Nodes<Real, D>&, int);                                                        \
  template double greatest_speed(const Scheme&, const Particles<Real, D>&, const Nodes<Real, D>&, \
                                 int);                                                            \
  template void remap(const Scheme&, Particles<Real, D>&, double, const Nodes<Real, D>&,          \
                      const Nodes<Real, D>&, Nodes<Real, D>&, int);                               \
  template void g2p(const Scheme&, Particles<Real, D>&, double, const Nodes<Real, D>&,            \
                    const Nodes<Real, D>&, int);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
