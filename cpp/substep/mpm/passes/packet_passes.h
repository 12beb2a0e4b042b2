// The passes, packet by packet: for the translation units packet_passes_*.cpp alone.
//
// P2G by moving least squares (Hu et al. 2018, eq. 16 with D_p = dx^2 / 4): node i gets the
// momentum w_i (m v + Q (i - f)), with Q = dx (m C - dt V_0 4 / dx^2 tau) and i - f in cells; mass
// w_i m. G2P: v = sum_i w_i v_i, C = 4 / dx sum_i w_i v_i (i - f)^T; then x += dt v, F <- (I + dt
// C) F.
//
// Where particles outnumber nodes, each with a volume of its own to keep, nodes have no freedom
// left to flow with (volumetric locking). So materials that flow at constant volume take div v from
// the cells, one number of each: in F's update alone the trace of C is the mean divergence of the
// cells around the particle (Stencil::divergence). That is the selective reduced integration of
// finite elements with one pressure a cell (Malkus, Hughes, "Mixed finite element methods - reduced
// and selective integration techniques", 1978), interpolated as the splines of velocity ask.
#pragma once

#include <algorithm>
#include <variant>

#include "substep/core/usize.h"
#include "substep/mpm/boundary/particle_boundary.h"
#include "substep/mpm/passes/passes.h"
#include "substep/mpm/passes/stencil.h"

namespace substep::mpm {

// Packets whose return map runs at a time: a material with long chains of operations has 2.
template <class M>
constexpr int together() {
  if constexpr (requires { M::kTogether; }) {
    return M::kTogether;
  } else {
    return 1;
  }
}

// v and C of a packet, and the mass in a cell around.
template <class Real, int D>
struct Motion {
  using V = Vector<Real>;
  V v[D];
  Tensor<V, D> C;
  V mass;
};

template <class Real, int D>
SUBSTEP_INLINE Motion<Real, D> gather(const Real* x, const Arena<Real, D>& from, Real cell) {
  using V = Vector<Real>;
  const Stencil<Real, D> stencil(x);
  alignas(64) V sums[16];
  stencil.gather(from, sums);
  Motion<Real, D> motion{};
  motion.mass = sums[D];
  const Real scale = 4 / cell;
  for (int c = 0; c < D; ++c) {
    motion.v[c] = sums[c];
    for (int d = 0; d < D; ++d) {
      motion.C(c, d) = scale * (sums[4 * (1 + d) + c] - stencil.f[d] * sums[c]);
    }
  }
  return motion;
}

template <class Real, int D>
SUBSTEP_INLINE void scatter(const Real* x, const Motion<Real, D>& motion,
                            const Vector<Real>& volume, const SymmetricTensor<Vector<Real>, D>& tau,
                            Real density, Real dt, Real cell, int count, Scatter<Real, D>& to) {
  using V = Vector<Real>;
  const Stencil<Real, D> stencil(x);
  const V m = density * volume, mass = m * cell, impulse = volume * (-4 * dt / cell);
  alignas(64) V affine[16] = {};
  for (int c = 0; c < D; ++c) {
    V momentum = m * motion.v[c];
    for (int d = 0; d < D; ++d) {
      const V q = fma(impulse, tau(c, d), mass * motion.C(c, d));
      affine[4 * (1 + d) + c] = q;
      momentum -= q * stencil.f[d];
    }
    affine[c] = momentum;
  }
  affine[D] = m;
  to.add(stencil, affine, count);
}

// AFLIP, apart from the passes, so that those of APIC are none the slower. What the grid does not
// see of a particle's motion, `kept` of it, stays with the particle: of v as in FLIP, and of the
// antisymmetric part of C, without which angular momentum would get lost. `old`: v, then spins, of
// the step before.
template <class Real, int D>
[[gnu::noinline]] void keep_unseen(const Real* x, const Real* old, const Arena<Real, D>& before,
                                   Real cell, Real kept, Motion<Real, D>& motion) {
  using V = Vector<Real>;
  const Motion<Real, D> seen = gather<Real, D>(x, before, cell);
  for (int d = 0; d < D; ++d) motion.v[d] += kept * (load<V>(old + d * kLanes<Real>) - seen.v[d]);
  for_each_spin<D>([&](int s, int i, int j) {
    const V spin = load<V>(old + (D + s) * kLanes<Real>);
    const V unseen = kept * (spin - Real(0.5) * (seen.C(i, j) - seen.C(j, i)));
    motion.C(i, j) += unseen;
    motion.C(j, i) -= unseen;
  });
}
template <class Real, int D>
SUBSTEP_INLINE void carry(const Motion<Real, D>& motion, Real* to) {
  using V = Vector<Real>;
  std::memcpy(to, motion.v, sizeof motion.v);
  for_each_spin<D>([&](int s, int i, int j) {
    const V spin = Real(0.5) * (motion.C(i, j) - motion.C(j, i));
    std::memcpy(to + (D + s) * kLanes<Real>, &spin, sizeof spin);
  });
}
// Adds w_i (m v + m C (x_i - x_p)).
template <class Real, int D>
[[gnu::noinline]] void scatter_before(const Real* x, const Motion<Real, D>& motion,
                                      const Vector<Real>& volume, Real density, Real cell,
                                      int count, Arena<Real, D>& before) {
  Scatter<Real, D> to(before);
  scatter<Real, D>(x, motion, volume, {}, density, 0, cell, count, to);
  to.flush();
}

// The packets of a run, kTogether at a time; those missing in the last set are spare copies of its
// first.
template <class M, class Real, int D>
struct PacketSet {
  using V = Vector<Real>;
  static constexpr int kWidth = kLanes<Real>, kSize = together<M>();
  static constexpr int kFields = M::template kFields<D>;

  alignas(64) V spare[kSize][kFields];
  V* fields[kSize];
  Tensor<V, D> G[kSize];
  SymmetricTensor<V, D> tau[kSize];

  static V* fields_of(Real* packet) { return reinterpret_cast<V*>(packet + D * kWidth); }
  // Spare copies for k >= active.
  SUBSTEP_INLINE void complete(int active) {
    for (int k = active; k < kSize; ++k) {
      for (int f = 0; f < kFields; ++f) spare[k][f] = fields[0][f];
      fields[k] = spare[k];
      G[k] = G[0];
    }
  }
  SUBSTEP_INLINE void stress(const M& material, Real dt) {
    material.template stress<V, D, kSize>(fields, G, dt, tau);
  }
};

// The stress of `active` packets where a run begins or ends: one copy of what takes longest to
// compile.
template <class M, class Real, int D>
[[gnu::noinline]] void stress_at_ends(const M& material, PacketSet<M, Real, D>& set, int active,
                                      Real dt) {
  set.complete(active);
  set.stress(material, dt);
}

template <class Real>
int lanes_in(const Run& run, int packet) {
  return std::min(kLanes<Real>, run.count - packet * kLanes<Real>);
}

template <class M, class Real, int D>
[[gnu::noinline]] void p2g_of(const M& material, const ParticleGroup<Real, D>& group,
                              const Run& run, const PassOptions<Real>& options, Arena<Real, D>& to,
                              const BeforeImpulses<Real, D>& before) {
  using Set = PacketSet<M, Real, D>;
  using V = typename Set::V;
  Scatter<Real, D> nodes(to);
  for (int first = 0; first < run.packets; first += Set::kSize) {
    const int active = std::min(Set::kSize, run.packets - first);
    Set set;
    Motion<Real, D> motion[Set::kSize];
    for (int k = 0; k < active; ++k) {
      const Real* const state = group.packet(run.first + first + k) + D * Set::kWidth;
      for (int f = 0; f < Set::kFields; ++f) set.spare[k][f] = load<V>(state + f * Set::kWidth);
      set.fields[k] = set.spare[k];
      const Real* const at_rest = group.motion(run.first + first + k);
      for (int c = 0; c < D; ++c) {
        motion[k].v[c] = load<V>(at_rest + c * Set::kWidth);
        for (int d = 0; d < D; ++d) {
          motion[k].C(c, d) = load<V>(at_rest + (D + c * D + d) * Set::kWidth);
        }
      }
      if constexpr (D == 2) motion[k].C.m[4] = V{};
      set.G[k] = motion[k].C;
    }
    stress_at_ends(material, set, active, options.before);
    for (int k = 0; k < active; ++k) {
      const std::int64_t packet = run.first + first + k;
      const auto density = static_cast<Real>(material.density);
      const V volume = load<V>(&group.volume[0] + packet * Set::kWidth);
      const int count = lanes_in<Real>(run, first + k);
      scatter(group.packet(packet), motion[k], volume, set.tau[k], density, options.next_dt,
              options.cell, count, nodes);
      if (options.kept >= 0) {
        scatter_before(group.packet(packet), motion[k], volume, density, options.cell, count,
                       *before.to);
      }
    }
  }
  nodes.flush();
}

// What both that read nodes do: fields, x and motion of a set of packets after the step.
template <class M, class Real, int D>
SUBSTEP_INLINE void advance(const M& material, ParticleGroup<Real, D>& group, const Run& run,
                            const PassOptions<Real>& options, std::int32_t block,
                            ParticleBoundary<Real, D>* walls, const Arena<Real, D>& from,
                            const BeforeImpulses<Real, D>& nodes_before, int first, int active,
                            Real* const* packets, PacketSet<M, Real, D>& set,
                            Motion<Real, D>* motion) {
  using Set = PacketSet<M, Real, D>;
  using V = typename Set::V;
  for (int k = 0; k < active; ++k) set.fields[k] = Set::fields_of(packets[k]);
  if (options.trial) {
    Set ended;
    for (int k = 0; k < active; ++k) ended.fields[k] = set.fields[k], ended.G[k] = Tensor<V, D>{};
    stress_at_ends(material, ended, active, options.before);
  }
  for (int k = 0; k < active; ++k) {
    Real* const x = packets[k];
    motion[k] = gather<Real, D>(x, from, options.cell);
    set.G[k] = motion[k].C;
    auto G = motion[k].C;
    if constexpr (averages_volume<M>()) {
      G = with_divergence<V, D>(G, Stencil<Real, D>(x).divergence(from) / options.cell);
    }
    material.template advance<V, D>(set.fields[k], G, options.dt);
    if constexpr (sees_density<M>()) {
      material.template see<V>(set.fields[k], motion[k].mass / power<D>(options.cell));
    }
    const Real scale = options.dt / options.cell;
    alignas(64) V before[D], after[D];
    for (int d = 0; d < D; ++d) {
      before[d] = load<V>(x + d * Set::kWidth);
      after[d] = fma<V>(scale, motion[k].v[d], before[d]);
    }
    constexpr int kCarried = (D + Set::kFields) * Set::kWidth;
    if (options.kept >= 0) {
      keep_unseen(x, x + kCarried, *nodes_before.from, options.cell, options.kept, motion[k]);
      set.G[k] = motion[k].C;
    }
    if (walls) {
      walls->settle(block, reinterpret_cast<const Real*>(before), reinterpret_cast<Real*>(after),
                    reinterpret_cast<Real*>(motion[k].v),
                    group.volume.data() + (run.first + first + k) * Set::kWidth, material.density,
                    lanes_in<Real>(run, first + k));
    }
    std::memcpy(x, after, sizeof after);
    if (options.kept >= 0) carry(motion[k], x + kCarried);
  }
}

template <class M, class Real, int D>
[[gnu::noinline]] void g2p2g_of(const M& material, ParticleGroup<Real, D>& group, const Run& run,
                                const PassOptions<Real>& options, std::int32_t block,
                                ParticleBoundary<Real, D>* walls, const Arena<Real, D>& from,
                                Arena<Real, D>& to, const BeforeImpulses<Real, D>& before) {
  using Set = PacketSet<M, Real, D>;
  using V = typename Set::V;
  Scatter<Real, D> nodes(to);
  for (int first = 0; first < run.packets; first += Set::kSize) {
    const int active = std::min(Set::kSize, run.packets - first);
    Real* packets[Set::kSize];
    for (int k = 0; k < active; ++k) {
      const std::int64_t packet = run.first + first + k;
      packets[k] = options.rest ? group.motion(packet) : group.packet(packet);
      if (options.rest) {
        std::memcpy(packets[k], group.packet(packet),
                    sizeof(V) * usize(D + Set::kFields + group.carried));
      }
    }
    Set set;
    Motion<Real, D> motion[Set::kSize];
    advance<M, Real, D>(material, group, run, options, block, walls, from, before, first, active,
                        packets, set, motion);
    set.complete(active);
    set.stress(material, options.dt);
    for (int k = 0; k < active; ++k) {
      const V volume = load<V>(&group.volume[0] + (run.first + first + k) * Set::kWidth);
      const auto density = static_cast<Real>(material.density);
      const int count = lanes_in<Real>(run, first + k);
      scatter(packets[k], motion[k], volume, set.tau[k], density, options.next_dt, options.cell,
              count, nodes);
      if (options.kept >= 0) {
        scatter_before(packets[k], motion[k], volume, density, options.cell, count, *before.to);
      }
    }
  }
  nodes.flush();
}

template <class M, class Real, int D>
[[gnu::noinline]] void g2p_of(const M& material, ParticleGroup<Real, D>& group, const Run& run,
                              const PassOptions<Real>& options, std::int32_t block,
                              ParticleBoundary<Real, D>* walls, const Arena<Real, D>& from,
                              const BeforeImpulses<Real, D>& before) {
  using Set = PacketSet<M, Real, D>;
  for (int first = 0; first < run.packets; first += Set::kSize) {
    const int active = std::min(Set::kSize, run.packets - first);
    Real* packets[Set::kSize];
    for (int k = 0; k < active; ++k) packets[k] = group.packet(run.first + first + k);
    Set set;
    Motion<Real, D> motion[Set::kSize];
    advance<M, Real, D>(material, group, run, options, block, walls, from, before, first, active,
                        packets, set, motion);
    for (int k = 0; k < active; ++k) {
      Real* const at_rest = group.motion(run.first + first + k);
      std::memcpy(at_rest, motion[k].v, sizeof motion[k].v);
      for (int c = 0; c < D; ++c) {
        for (int d = 0; d < D; ++d) {
          const auto entry = motion[k].C(c, d);
          std::memcpy(at_rest + (D + c * D + d) * Set::kWidth, &entry, sizeof entry);
        }
      }
    }
  }
}

template <class Real, int D>
void Passes<Real, D>::p2g(const AnyMaterial& material, const Group& group, const Run& run,
                          const PassOptions<Real>& options, Arena<Real, D>& to,
                          const BeforeImpulses<Real, D>& before) {
  std::visit([&](const auto& m) { p2g_of(m, group, run, options, to, before); }, material);
}

template <class Real, int D>
void Passes<Real, D>::g2p2g(const AnyMaterial& material, Group& group, const Run& run,
                            const PassOptions<Real>& options, std::int32_t block, Walls* walls,
                            const Arena<Real, D>& from, Arena<Real, D>& to,
                            const BeforeImpulses<Real, D>& before) {
  std::visit(
      [&](const auto& m) { g2p2g_of(m, group, run, options, block, walls, from, to, before); },
      material);
}

template <class Real, int D>
void Passes<Real, D>::g2p(const AnyMaterial& material, Group& group, const Run& run,
                          const PassOptions<Real>& options, std::int32_t block, Walls* walls,
                          const Arena<Real, D>& from, const BeforeImpulses<Real, D>& before) {
  std::visit([&](const auto& m) { g2p_of(m, group, run, options, block, walls, from, before); },
             material);
}

}  // namespace substep::mpm
