#include "substep/mpm/passes/transfers.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/mpm/boundary/particle_boundary.h"
#include "substep/mpm/passes/passes.h"
#include "substep/mpm/passes/scatter_blocks.h"

namespace substep::mpm {
namespace {

// Calls pass(material, group, run) for every group that has particles in the block.
template <class Groups, class Pass>
void for_each_group(const std::vector<AnyMaterial>& materials, Groups& groups, std::size_t block,
                    Pass&& pass) {
  for (std::size_t g = 0; g < groups.size(); ++g) {
    const Run& run = groups[g].runs[block];
    if (run.count > 0) pass(materials[g], groups[g], run);
  }
}

template <class Real, int D>
ParticleBoundary<Real, D>* walls_near(const Particles<Real, D>& particles, std::size_t block) {
  ParticleBoundary<Real, D>* const walls = particles.walls;
  return walls && walls->near(static_cast<std::int32_t>(block)) ? walls : nullptr;
}

template <class Real, int D>
PassOptions<Real> options_of(const Particles<Real, D>& particles, double dt, double next_dt) {
  const double kept = particles.flip_rate < 0 ? -1 : std::exp(-particles.flip_rate * dt);
  return {static_cast<Real>(particles.cell),
          static_cast<Real>(dt),
          static_cast<Real>(next_dt),
          static_cast<Real>(particles.before),
          particles.trial,
          particles.motion,
          static_cast<Real>(kept)};
}

// v^before of the nodes of a block, whose masses are those of `velocities`.
template <class Real, int D>
void copy_before(const Nodes<Real, D>& nodes, const transfer::BlockLayout<D>& layout,
                 std::size_t block, const Arena<Real, D>& velocities, Arena<Real, D>& before) {
  before.copy(nodes, layout, block, 1);
  for (int i = 0; i < before.kReals; i += transfer::kNodeReals) {
    const Real mass = velocities.nodes[i + D];
    const Real inverse = mass < std::numeric_limits<Real>::min() ? 0 : 1 / mass;
    for (int d = 0; d < D; ++d) before.nodes[i + d] *= inverse;
  }
}

}  // namespace

template <class Real, int D>
void p2g(const Particles<Real, D>& particles, double dt, Nodes<Real, D>& nodes, int threads) {
  const auto options = options_of(particles, 0, dt);
  const bool two = layers_of(particles) == 2;
  const auto scatter = [&](std::size_t block, auto& arena) {
    Arena<Real, D> plain;
    if (two) plain.set_zero();
    for_each_group(particles.materials, particles.groups, block,
                   [&](const AnyMaterial& material, const auto& group, const Run& run) {
                     Passes<Real, D>::p2g(material, group, run, options, arena, {nullptr, &plain});
                   });
    if (two) plain.add_to(nodes, particles.layout, block, 1);
  };
  scatter_blocks<Real, D>(particles.layout, nodes, threads, scatter, layers_of(particles));
}

template <class Real, int D>
void g2p2g(Particles<Real, D>& particles, double dt, double next_dt, const Nodes<Real, D>& from,
           Nodes<Real, D>& to, int threads) {
  const auto options = options_of(particles, dt, next_dt);
  if (options.rest) particles.snapshot = {false, particles.trial, particles.before};
  const bool two = layers_of(particles) == 2;
  const auto pass = [&](std::size_t block, auto& arena) {
    Arena<Real, D> velocities, before, plain;
    velocities.copy(from, particles.layout, block);
    if (two) {
      copy_before(from, particles.layout, block, velocities, before);
      plain.set_zero();
    }
    for_each_group(particles.materials, particles.groups, block,
                   [&](const AnyMaterial& material, auto& group, const Run& run) {
                     Passes<Real, D>::g2p2g(
                         material, group, run, options, static_cast<std::int32_t>(block),
                         walls_near(particles, block), velocities, arena, {&before, &plain});
                   });
    if (two) plain.add_to(to, particles.layout, block, 1);
  };
  scatter_blocks<Real, D>(particles.layout, to, threads, pass, layers_of(particles));
  if (options.rest) {
    for (auto& group : particles.groups) group.state.swap(group.other);
  }
  particles.motion = particles.trial = false;
  particles.before = dt;
}

template <class Real, int D>
void g2p(Particles<Real, D>& particles, double dt, const Nodes<Real, D>& nodes, int threads) {
  const auto options = options_of(particles, dt, 0);
  if (!options.rest) {  // the snapshot may have had fewer packets
    for (auto& group : particles.groups) group.other.reset(group.state.size());
  }
  parallel_for(
      particles.layout.blocks(), kBlocksOfScatter,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          const auto block = usize(b);
          Arena<Real, D> velocities, before;
          velocities.copy(nodes, particles.layout, block);
          if (layers_of(particles) == 2) {
            copy_before(nodes, particles.layout, block, velocities, before);
          }
          for_each_group(particles.materials, particles.groups, block,
                         [&](const AnyMaterial& material, auto& group, const Run& run) {
                           Passes<Real, D>::g2p(
                               material, group, run, options, static_cast<std::int32_t>(block),
                               walls_near(particles, block), velocities, {&before, nullptr});
                         });
        }
      },
      threads);
  particles.motion = particles.trial = true;
  particles.before = dt;
}

template <class Real, int D>
void carry_velocities(Particles<Real, D>& particles, int threads) {
  if (layers_of(particles) == 1 || !particles.motion) return;
  for (auto& group : particles.groups) {
    const int after = (D + group.fields) * kLanes<Real>;
    parallel_for(
        group.packets, 64,
        [&](std::int64_t begin, std::int64_t end) {
          for (std::int64_t p = begin; p < end; ++p) {
            using V = Vector<Real>;
            constexpr int kWidth = kLanes<Real>;
            const Real* const motion = group.motion(p);
            Real* const to = group.packet(p) + after;
            std::memcpy(to, motion, D * sizeof(V));
            for_each_spin<D>([&](int s, int i, int j) {
              const V spin = (load<V>(motion + (D + D * i + j) * kWidth) -
                              load<V>(motion + (D + D * j + i) * kWidth)) *
                             Real(0.5);
              std::memcpy(to + (D + s) * kWidth, &spin, sizeof spin);
            });
          }
        },
        threads);
  }
}

#define SUBSTEP_INSTANTIATE(Real, D)                                                       \
  template void p2g<Real, D>(const Particles<Real, D>&, double, Nodes<Real, D>&, int);     \
  template void g2p2g<Real, D>(Particles<Real, D>&, double, double, const Nodes<Real, D>&, \
                               Nodes<Real, D>&, int);                                      \
  template void g2p<Real, D>(Particles<Real, D>&, double, const Nodes<Real, D>&, int);     \
  template void carry_velocities<Real, D>(Particles<Real, D>&, int);
SUBSTEP_INSTANTIATE(float, 2)
SUBSTEP_INSTANTIATE(float, 3)
SUBSTEP_INSTANTIATE(double, 2)
SUBSTEP_INSTANTIATE(double, 3)
#undef SUBSTEP_INSTANTIATE

}  // namespace substep::mpm
