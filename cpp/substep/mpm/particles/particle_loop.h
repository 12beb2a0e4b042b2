// Loops over all particles, block by block: in parallel, and sums in an order of their own.
#pragma once

#include <vector>

#include "substep/core/parallel.h"
#include "substep/core/usize.h"
#include "substep/geometry/collider.h"
#include "substep/mpm/particles/particles.h"

namespace substep::mpm {

inline constexpr std::int64_t kBlocksOfTask = 32;

// Where a particle is stored.
struct Slot {
  std::size_t group;
  std::int64_t packet;
  int lane;
  std::int32_t block;  // of the layout

  template <class Real>
  std::size_t id_index() const {
    return usize(packet * kLanes<Real> + lane);
  }
};

// packet(group, packet, particle block, particles in it), group by group.
template <class Real, int D, class Packet>
void for_packets_of_block(const Particles<Real, D>& particles, std::int32_t block,
                          const Packet& packet) {
  for (std::size_t g = 0; g < particles.groups.size(); ++g) {
    if (particles.groups[g].runs.empty()) continue;
    const Run& run = particles.groups[g].runs[usize(block)];
    for (std::int32_t p = 0; p < run.packets; ++p) {
      packet(g, run.first + p, block, std::min(run.count - p * kLanes<Real>, kLanes<Real>));
    }
  }
}

template <class Real, int D, class Packet>
void for_packets(const Particles<Real, D>& particles, const Packet& packet, int threads) {
  parallel_for(
      static_cast<std::int64_t>(particles.layout.particle_keys.size()), kBlocksOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t b = begin; b < end; ++b) {
          for_packets_of_block(particles, static_cast<std::int32_t>(b), packet);
        }
      },
      threads);
}

// particle(slot), each once.
template <class Real, int D, class Particle>
void for_particles(const Particles<Real, D>& particles, const Particle& particle, int threads) {
  for_packets(
      particles,
      [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
        for (int lane = 0; lane < count; ++lane) particle(Slot{g, p, lane, block});
      },
      threads);
}

// The sum of what packet(...) returns: anything with +=, which may be a maximum.
template <class Real, int D, class Packet>
auto sum_of_packets(const Particles<Real, D>& particles, const Packet& packet, int threads) {
  using Sum = decltype(packet(std::size_t{}, std::int64_t{}, std::int32_t{}, int{}));
  const auto blocks = static_cast<std::int64_t>(particles.layout.particle_keys.size());
  std::vector<Sum> parts(usize((blocks + kBlocksOfTask - 1) / kBlocksOfTask));
  parallel_for(
      blocks, kBlocksOfTask,
      [&](std::int64_t begin, std::int64_t end) {
        Sum part{};
        for (std::int64_t b = begin; b < end; ++b) {
          for_packets_of_block(particles, static_cast<std::int32_t>(b),
                               [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
                                 part += packet(g, p, block, count);
                               });
        }
        parts[usize(begin / kBlocksOfTask)] = part;
      },
      threads);
  Sum sum{};
  for (const Sum& part : parts) sum += part;
  return sum;
}

// Numbers of a particle in one of its group's buffers.
template <class Real, int D>
Real& state_of(Particles<Real, D>& particles, const Slot& s, int f) {
  return particles.groups[s.group].packet(s.packet)[f * kLanes<Real> + s.lane];
}
template <class Real, int D>
Real state_of(const Particles<Real, D>& particles, const Slot& s, int f) {
  return particles.groups[s.group].packet(s.packet)[f * kLanes<Real> + s.lane];
}
template <class Real, int D>
Real& motion_of(Particles<Real, D>& particles, const Slot& s, int f) {
  return particles.groups[s.group].motion(s.packet)[f * kLanes<Real> + s.lane];
}
template <class Real, int D>
Real motion_of(const Particles<Real, D>& particles, const Slot& s, int f) {
  return particles.groups[s.group].motion(s.packet)[f * kLanes<Real> + s.lane];
}
template <class Real, int D>
std::int32_t id_of(const Particles<Real, D>& particles, const Slot& s) {
  return particles.groups[s.group].ids[s.id_index<Real>()];
}

// The id of the particle of the greatest score, the lowest of equal ones; -1 if there is none.
// score(group, packet, particle block, particles in it, scores) sets those of a packet: 0 or more,
// or -1 for a particle that does not count.
template <class Real, int D, class Score>
std::int32_t id_of_greatest(const Particles<Real, D>& particles, const Score& score) {
  double greatest = -1;
  std::int32_t found = -1;
  for (std::size_t b = 0; b < particles.layout.particle_keys.size(); ++b) {
    for_packets_of_block(
        particles, static_cast<std::int32_t>(b),
        [&](std::size_t g, std::int64_t p, std::int32_t block, int count) {
          double scores[kLanes<Real>];
          score(g, p, block, count, scores);
          for (int lane = 0; lane < count; ++lane) {
            const std::int32_t id = id_of(particles, Slot{g, p, lane, block});
            if (scores[lane] > greatest || (scores[lane] == greatest && id < found)) {
              greatest = scores[lane];
              found = id;
            }
          }
        });
  }
  return found;
}

// World position [m]; in 2D z = 0.
template <class Real, int D>
geometry::Vec3 position_of(const Particles<Real, D>& particles, const Slot& s) {
  const auto block = transfer::BlockKey<D>::unpack(particles.layout.particle_keys[usize(s.block)]);
  geometry::Vec3 x = geometry::Vec3::Zero();
  for (int d = 0; d < D; ++d) {
    x[d] = particles.cell * (static_cast<double>(transfer::kBlock) * block[usize(d)] +
                             static_cast<double>(state_of(particles, s, d)));
  }
  return x;
}
template <class Real, int D>
geometry::Vec3 velocity_of(const Particles<Real, D>& particles, const Slot& s) {
  geometry::Vec3 v = geometry::Vec3::Zero();
  for (int d = 0; d < D; ++d) v[d] = static_cast<double>(motion_of(particles, s, d));
  return v;
}

inline double density(const AnyMaterial& material) {
  return std::visit([](const auto& m) { return static_cast<double>(m.density); }, material);
}

}  // namespace substep::mpm
