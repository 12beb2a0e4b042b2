// Particles, grouped by material, sorted by particle block and cell, in packets of kLanes: number f
// of the particle in lane l of packet p is at values[(p * stride + f) * kLanes + l].
//
// Position x is in cells, from the first node of the arena of the particle's block: so its
// precision is the same everywhere. Packets do not cross blocks; the lanes after the last particle
// of a block repeat it, and are not scattered.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "substep/core/aligned_buffer.h"
#include "substep/core/lanes.h"
#include "substep/mpm/materials/materials.h"
#include "substep/transfer/blocks.h"

namespace substep::mpm {

template <class Real>
inline constexpr int kLanes = kVectorBytes / static_cast<int>(sizeof(Real));

// A particle that has not moved since it was sorted has kFirstPosition <= x < kFirstPosition + 4.
inline constexpr double kFirstPosition = 1.5;

// How far, in cells, particles may move along an axis after they were sorted: a spline of this
// order then still stays within the arena. (A hundredth is for rounding.)
constexpr double drift_limit(int order) { return 2 - 0.5 * order - 0.01; }

// Packets of one particle block.
struct Run {
  std::int64_t first = 0;  // packet
  std::int32_t packets = 0;
  std::int32_t count = 0;  // particles
};

// The antisymmetric part of C is D (D - 1) / 2 numbers: (C_ij - C_ji) / 2 for i < j.
template <int D>
inline constexpr int kSpins = D * (D - 1) / 2;
// Calls each(number, i, j) for them.
template <int D, class Each>
constexpr void for_each_spin(Each&& each) {
  for (int i = 0, s = 0; i < D; ++i) {
    for (int j = i + 1; j < D; ++j) each(s++, i, j);
  }
}

// Particles of one material. Two buffers of packets are all that a particle has. Between the calls
// of its owner one holds the state and the other the motion; while steps run, velocities live on
// the grid, and the other buffer is the snapshot from which a failed run of steps is repeated, and
// the target of the next sort.
template <class Real, int D>
struct ParticleGroup {
  static constexpr int kMotion =
      D + D * D;  // v [m/s], then C [1/s], whose rows are components of v
  static constexpr int kCarried = D + kSpins<D>;

  int fields = 0;              // of the material, kFields<D>
  int carried = 0;             // kCarried where v and the spin go with the state while steps run
                               // (AFLIP), else 0
  AlignedBuffer<Real> state;   // x (D), then the material's fields, then what is carried
  AlignedBuffer<Real> other;   // motion: v (D), C (D x D); or what state was when it was put aside
  AlignedBuffer<Real> volume;  // of each lane: at rest, V_0 [m^3]
  AlignedBuffer<std::int32_t> ids;   // of each lane; -1: repeats
  AlignedBuffer<std::int32_t> from;  // of each lane: where in `other` it was before the last sort
  std::vector<Run> runs;             // of each particle block; count 0 where it has none here
  std::int64_t packets = 0, count = 0;

  // Numbers of a packet, of either buffer.
  int stride() const { return std::max(D + fields + carried, kMotion); }
  Real* packet(std::int64_t p) { return state.data() + p * stride() * kLanes<Real>; }
  const Real* packet(std::int64_t p) const { return state.data() + p * stride() * kLanes<Real>; }
  Real* motion(std::int64_t p) { return other.data() + p * stride() * kLanes<Real>; }
  const Real* motion(std::int64_t p) const { return other.data() + p * stride() * kLanes<Real>; }
};

template <class Real, int D>
class ParticleBoundary;

template <class Real, int D>
struct Particles {
  double cell = 1;  // dx [m]
  std::vector<AnyMaterial> materials;
  std::vector<ParticleGroup<Real, D>> groups;  // one per material
  transfer::BlockLayout<D> layout;             // of all groups
  bool motion = true;                          // at rest: `other` holds v and C
  bool trial = true;                           // the return map of the last step is still to come
  double before = 0;                           // dt of that step [s]
  double flip_rate = -1;                       // AFLIP's [1/s]; below 0: APIC
  // Keeps them out of obstacles, where there are any: whoever moves particles (g2p, g2p2g) calls
  // settle() for the packets of blocks that are near(), once x has advanced and before v is used.
  ParticleBoundary<Real, D>* walls = nullptr;

  // What rewind() needs besides `other`.
  struct Snapshot {
    bool sorted = false;  // particles were sorted since: `other` is in the order before
    bool trial = false;
    double before = 0;
  } snapshot;
};

// Particles of one material as rows, in any order.
template <class Real, int D>
struct ParticleRows {
  std::vector<transfer::Index<D>> blocks;  // particle block of each
  std::vector<Real> state;                 // n x (D + fields)
  std::vector<Real> motion;                // n x kMotion
  std::vector<Real> volume;
  std::vector<std::int32_t> ids;
};

// Particle block and x of a particle at X [cells], along one axis.
struct Place {
  std::int32_t block;
  double x;
};
inline Place place(double X) {
  const double block = std::floor((X - kFirstPosition) / transfer::kBlock);
  return {static_cast<std::int32_t>(block), X - transfer::kBlock * block};
}

// How assign() orders the particles of a block.
enum class Order {
  kCells,    // by cell, then as given; every x must be as place() gives it
  kAsGiven,  // a state that rows() gave: the same bits follow
};

// Replaces all particles, by those of one entry of rows per material (materials and cell are set).
template <class Real, int D>
void assign(Particles<Real, D>& particles, std::span<const ParticleRows<Real, D>> rows, Order order,
            int threads);

// Particles of a group, in the order of its packets. At rest.
template <class Real, int D>
ParticleRows<Real, D> rows(const Particles<Real, D>& particles, std::size_t group);

}  // namespace substep::mpm
