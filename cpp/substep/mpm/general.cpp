#include "substep/mpm/general.h"

#include <cmath>

#include "substep/core/parallel.h"
#include "substep/mpm/general_materials.h"
#include "substep/mpm/general_stencil.h"
#include "substep/transfer/weights.h"

namespace substep::mpm {

namespace {

// MLS forces need D^-1, which order 1 has only together with its weights: as gradients.
bool textbook(const Scheme& scheme) { return scheme.form == Form::kTextbook || scheme.order == 1; }

double inverse_moment(int order) {  // D^-1 [1/cell^2]
  return 1 / (order == 2 ? transfer::kSecondMoment<2> : transfer::kSecondMoment<3>);
}

// task(particle block) for all that scatter, colour by colour.
template <int D>
void for_coloured_blocks(const transfer::BlockLayout<D>& layout,
                         const std::function<void(std::int32_t)>& task, int threads) {
  std::array<std::int64_t, 1 << D> chunks;
  for (std::size_t c = 0; c < chunks.size(); ++c) {
    chunks[c] = static_cast<std::int64_t>(layout.colours[c].size());
  }
  parallel_phases(
      chunks,
      [&](std::int64_t colour, std::int64_t i) {
        task(layout.colours[static_cast<std::size_t>(colour)][static_cast<std::size_t>(i)]);
      },
      threads);
}

// visit(group, packet, particles in it) for the packets of a block.
template <class Groups, class Visit>
void for_packets(Groups& groups, std::int32_t block, int lanes, Visit&& visit) {
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const Run& run = groups[g].runs[static_cast<std::size_t>(block)];
    for (std::int32_t p = 0; p < run.packets; ++p) {
      visit(g, run.first + p, std::min(lanes, run.count - p * lanes));
    }
  }
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
  const double rho = std::visit([](const auto& m) { return double(m.density); }, material);
  const double dx = particles.cell;
  const Real* v = group.motion(packet);
  const auto C = load_gradient<Real, D>(v + D * kLanes<Real>);
  SymmetricTensor<V, D> tau;
  packet_stress<Real, D>(material, group.packet(packet) + D * kLanes<Real>, C, Real(dt), tau);

  const V volume = load<V>(group.volume.data() + packet * kLanes<Real>);
  const V mass = volume * Real(rho);
  const bool apic = scheme.transfer == Transfer::kApic;
  const V mass_dx = mass * Real(apic ? dx : 0);  // arms are in cells
  const V impulse = volume * Real(-dt / dx);     // and so are gradients
  const V mls = textbook(scheme) ? V{} : V(impulse * Real(inverse_moment(scheme.order)));
  const auto store = [](Real* lanes, const V& value) { std::memcpy(lanes, &value, sizeof value); };
  store(to.p[D], mass);
  for (int i = 0; i < D; ++i) {
    store(to.p[i], mass * load<V>(v + i * kLanes<Real>));
    for (int j = 0; j < D; ++j) {
      store(to.A[i][j], fma(mass_dx, C(i, j), mls * tau(i, j)));
      store(to.T[i][j], impulse * tau(i, j));
    }
  }
}

// v_i^before: momentum becomes velocity.
template <class Real, int D>
void divide_by_mass(transfer::Arena<Real, D>& arena) {
  for (int n = 0; n < arena.kNodes; ++n) {
    Real* node = arena.node(n);
    const Real inverse = node[D] > 0 ? 1 / node[D] : 0;
    for (int d = 0; d < D; ++d) node[d] *= inverse;
  }
}

// The lanes after the last particle of a packet repeat it.
template <class Real, int D>
void repeat_last(int count, PacketVelocities<Real, D>& packet) {
  Real* rows[] = {packet.v[0], packet.C[0][0], packet.G[0][0]};
  const int numbers[] = {D, D * D, D * D};
  for (int k = 0; k < 3; ++k) {
    for (int n = 0; n < numbers[k]; ++n) {
      Real* row = rows[k] + n * kLanes<Real>;
      for (int lane = count; lane < kLanes<Real>; ++lane) row[lane] = row[count - 1];
    }
  }
}

// New v, C, x and fields of one packet; `before` is the old velocity of the grid for FLIP.
template <class Real, int D>
void advance_packet(const Scheme& scheme, Particles<Real, D>& particles, std::size_t g,
                    std::int64_t packet, double dt, const PacketVelocities<Real, D>& from,
                    const PacketVelocities<Real, D>* before) {
  using V = Vector<Real>;
  ParticleGroup<Real, D>& group = particles.groups[g];
  const Real per_cell = Real(1 / particles.cell), alpha = Real(std::exp(-scheme.flip_rate * dt));
  Real *x = group.packet(packet), *v = group.motion(packet), *C = v + D * kLanes<Real>;
  const auto store = [](Real* lanes, const V& value) { std::memcpy(lanes, &value, sizeof value); };
  const auto& G = textbook(scheme) ? from.G : from.C;
  const auto& stored = scheme.transfer == Transfer::kApic ? from.C : G;
  Tensor<V, D> gradient{};
  for (int i = 0; i < D; ++i) {
    const int row = i * kLanes<Real>;
    const V moved = load<V>(from.v[i]);
    V velocity = moved;
    if (before) velocity += (load<V>(v + row) - load<V>(before->v[i])) * alpha;
    store(v + row, velocity);
    store(x + row, fma(moved, splat<V>(Real(dt) * per_cell), load<V>(x + row)));
    for (int j = 0; j < D; ++j) {
      store(C + (i * D + j) * kLanes<Real>, load<V>(stored[i][j]) * per_cell);
      gradient(i, j) = load<V>(G[i][j]) * per_cell;
    }
  }
  packet_advance<Real, D>(particles.materials[g], x + D * kLanes<Real>, particles.trial, gradient,
                          Real(dt));
}

}  // namespace

template <class Real, int D>
void p2g(const Scheme& scheme, const Particles<Real, D>& particles, double dt,
         Nodes<Real, D>& nodes, Nodes<Real, D>& before, int threads) {
  const auto& layout = particles.layout;
  const bool flip = scheme.transfer == Transfer::kFlip;
  const auto blocks = static_cast<std::int64_t>(layout.node_keys.size());
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, textbook(scheme));
  nodes.set_zero(blocks, threads);
  if (flip) before.set_zero(blocks, threads);
  for_coloured_blocks<D>(
      layout,
      [&](std::int32_t block) {
        transfer::Arena<Real, D> arena, plain;
        PacketMomenta<Real, D> momenta;
        arena.clear();
        if (flip) plain.clear();
        for_packets(particles.groups, block, kLanes<Real>,
                    [&](std::size_t g, std::int64_t packet, int count) {
                      const Real* x = particles.groups[g].packet(packet);
                      packet_momenta(scheme, particles, g, packet, dt, momenta);
                      stencil.scatter(x, count, momenta, arena);
                      if (!flip) return;
                      std::memset(momenta.A, 0, sizeof momenta.A);
                      std::memset(momenta.T, 0, sizeof momenta.T);
                      stencil.scatter(x, count, momenta, plain);
                    });
        const auto& corners = layout.arenas[static_cast<std::size_t>(block)];
        arena.add_to(nodes, corners);
        if (flip) plain.add_to(before, corners);
      },
      threads);
}

template <class Real, int D>
void g2p(const Scheme& scheme, Particles<Real, D>& particles, double dt,
         const Nodes<Real, D>& nodes, const Nodes<Real, D>& before, int threads) {
  const auto& layout = particles.layout;
  const bool flip = scheme.transfer == Transfer::kFlip;
  const Stencils<Real, D> stencil = stencils<Real, D>(scheme.order, textbook(scheme));
  parallel_chunks(
      static_cast<std::int64_t>(layout.particle_keys.size()),
      [&](std::int64_t b) {
        transfer::Arena<Real, D> arena, plain;
        PacketVelocities<Real, D> velocities, old;
        const auto& corners = layout.arenas[static_cast<std::size_t>(b)];
        arena.gather(nodes, corners);
        if (flip) {
          plain.gather(before, corners);
          divide_by_mass<Real, D>(plain);
        }
        for_packets(particles.groups, static_cast<std::int32_t>(b), kLanes<Real>,
                    [&](std::size_t g, std::int64_t packet, int count) {
                      const Real* x = particles.groups[g].packet(packet);
                      stencil.gather(x, count, arena, velocities);
                      repeat_last<Real, D>(count, velocities);
                      if (flip) {
                        stencil.gather(x, count, plain, old);
                        repeat_last<Real, D>(count, old);
                      }
                      advance_packet(scheme, particles, g, packet, dt, velocities,
                                     flip ? &old : nullptr);
                    });
      },
      threads);
  particles.trial = true;
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                   \
  template void p2g(const Scheme&, const Particles<Real, D>&, double, Nodes<Real, D>&, \
                    Nodes<Real, D>&, int);                                             \
  template void g2p(const Scheme&, Particles<Real, D>&, double, const Nodes<Real, D>&, \
                    const Nodes<Real, D>&, int);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
